import { useEffect, useRef, useState } from 'preact/hooks'
import { get, post } from '../api/client'
import { explain, type PageError } from '../api/page-error'
import type { Capture } from '../api/types'
import { nameOf, selection, upload, type Dropped, type Selection } from '../api/upload'
import { filesIn, filesOf } from '../dropped'
import { bytes } from '../format'
import { release } from '../object-url'
import { photographsOf } from '../photos'
import { Failure } from './common'

/** Maximum number of thumbnails of dropped photographs. */
const SHOWN = 24
/** Interval between two requests for a capture during its validation, milliseconds. */
const POLL = 700

interface Sending {
  what: string
  sent: number
  total: number
}

/** Accepts a capture: photographs, a folder or an archive, with or without camera positions. */
export function DropZone({ onDone }: { onDone: (capture: Capture) => void }) {
  const [over, setOver] = useState(false)
  const [sending, setSending] = useState<Sending>()
  const [photographs, setPhotographs] = useState<Dropped[]>([])
  const [error, setError] = useState<PageError>()
  const [again, setAgain] = useState<() => void>()
  const stop = useRef<AbortController | undefined>(undefined)
  const archive = useRef<HTMLInputElement>(null)
  const folder = useRef<HTMLInputElement>(null)

  const work = async (making: (signal: AbortSignal) => Promise<Capture>) => {
    setError(undefined)
    const begun = new AbortController()
    stop.current = begun
    try {
      onDone(await making(begun.signal))
    } catch (failure) {
      if (!begun.signal.aborted) setError(explain(failure))
    } finally {
      setSending(undefined)
      setPhotographs([])
    }
  }
  const take = (dropped: Dropped[] | Promise<Dropped[]>) => {
    const taken = async (signal: AbortSignal) => {
      const what = selection(await dropped)
      setPhotographs(photographsOf(what))
      return send(what, signal, setSending)
    }
    setAgain(() => () => void work(taken))
    return work(taken)
  }
  const sample = () => {
    setAgain(() => () => void sample())
    setSending({ what: 'The server makes the sample', sent: 1, total: 1 })
    return work(() => post<Capture>('v1/captures?name=Sample', { sample: true }))
  }

  return (
    <section
      class={over ? 'drop over' : 'drop'}
      aria-label="New capture"
      onDragOver={(event) => {
        event.preventDefault()
        setOver(true)
      }}
      onDragLeave={() => setOver(false)}
      onDrop={(event) => {
        event.preventDefault()
        setOver(false)
        if (event.dataTransfer && !sending) void take(filesOf(event.dataTransfer))
      }}
    >
      {sending ? <Progress of={sending} onStop={() => stop.current?.abort()} /> : (
        <Invitation onFiles={() => archive.current?.click()} onFolder={() => folder.current?.click()} onSample={() => void sample()} />
      )}
      <input ref={archive} type="file" multiple hidden aria-label="Files of a capture" onChange={(event) => void take(chosen(event.currentTarget))} />
      <input ref={folder} type="file" {...{ webkitdirectory: true }} hidden aria-label="Folder of a capture" onChange={(event) => void take(chosen(event.currentTarget))} />
      {photographs.length ? <Photographs of={photographs} /> : null}
      <Failure error={error} {...(again ? { retry: again } : {})} />
    </section>
  )
}

/** The files of an input, which is then empty: browsers report the choice of a changed file with the same name only then. */
function chosen(input: HTMLInputElement): Dropped[] {
  const files = filesIn(input.files)
  input.value = ''
  return files
}

/** What can be dropped, and the buttons for those who do not drop. */
function Invitation({ onFiles, onFolder, onSample }: { onFiles: () => void; onFolder: () => void; onSample: () => void }) {
  return (
    <>
      <h2>Drop photographs here</h2>
      <p class="muted">30 or more photographs of one thing, taken from all sides. The server finds out where each was taken, which needs COLMAP on it.</p>
      <div class="row">
        <button class="primary" type="button" onClick={onFiles}>Choose photographs or a zip</button>
        <button type="button" onClick={onFolder}>Choose a folder</button>
        <button type="button" onClick={onSample}>Try the sample</button>
      </div>
      <details class="left">
        <summary>If you already know the camera positions</summary>
        <p class="small muted">Send them with the photographs, in one zip or folder: COLMAP files, or a <code>transforms.json</code> as NeRF programs write it. The server then needs no COLMAP.</p>
      </details>
    </>
  )
}

/** Uploads a capture, then waits until the server has validated it. */
async function send(what: Selection, signal: AbortSignal, tell: (sending: Sending) => void): Promise<Capture> {
  const name = nameOf(what)
  const label = 'archive' in what ? what.archive.name : `${what.files.length} files`
  tell({ what: `Uploading ${label}`, sent: 0, total: 1 })
  let capture = await upload(what, name, (sent, total) => tell({ what: sent < total ? `Uploading ${label}` : 'Checking the files', sent, total }), signal)
  // The search for poses takes long; the page of the capture shows its progress.
  while (capture.state === 'validating' && !capture.poses) {
    tell({ what: 'Checking the files', sent: 1, total: 1 })
    await new Promise((done) => setTimeout(done, POLL))
    signal.throwIfAborted()
    capture = await get<Capture>(`v1/captures/${capture.id}`)
  }
  return capture
}

function Progress({ of: { what, sent, total }, onStop }: { of: Sending; onStop: () => void }) {
  const percent = Math.floor((100 * sent) / Math.max(total, 1))
  // Screen readers announce steps of 10 %, not every chunk.
  const spoken = `${what}, ${Math.floor(percent / 10) * 10} %`
  return (
    <div class="stack">
      <h2>{what}</h2>
      <progress value={sent} max={total} aria-label={what} />
      <div class="row">
        <span class="muted small">{total > 1 ? `${bytes(sent)} of ${bytes(total)}` : 'This takes some seconds'}</span>
        <button type="button" onClick={onStop}>Stop</button>
      </div>
      {total > 1 ? <p class="hint">If the upload of a zip breaks off, drop the same file again: the upload continues where it was.</p> : null}
      <span aria-live="polite" class="skip">{spoken}</span>
    </div>
  )
}

/** Thumbnails of the first photographs. */
function Photographs({ of: photographs }: { of: Dropped[] }) {
  const [urls, setUrls] = useState<{ path: string; url: string }[]>([])
  useEffect(() => {
    const every = Math.max(1, Math.ceil(photographs.length / SHOWN))
    const readable = photographs.filter(({ path }, i) => i % every === 0 && !/\.(exr|tiff?)$/i.test(path))
    const made = readable.map(({ path, file }) => ({ path, url: URL.createObjectURL(file) }))
    setUrls(made)
    return () => made.forEach(({ url }) => release(url))
  }, [photographs])
  return (
    <ul class="photos" aria-label={`${photographs.length} photographs`}>
      {urls.map(({ path, url }) => <li key={path}><img src={url} alt={path} loading="lazy" /></li>)}
    </ul>
  )
}
