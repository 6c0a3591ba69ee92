import { useEffect, useRef, useState } from 'preact/hooks'
import { address, apiKey, ask, message, remove } from '../api/client'
import type { Environments, Model } from '../api/types'
import { Choices, Facts, Failure, Head, save, Slider } from '../components/common'
import { Lights } from '../components/lights'
import { TakeAlong } from '../components/take'
import { Wipe } from '../components/wipe'
import { bytes, called, count, decibels, duration, share } from '../format'
import { useLoaded, useTitle } from '../hooks'
import { backgroundOf, curl, OUTPUTS, readLook, readView, requestOf, written, type Look, type View } from '../look'
import { describe, go, link } from '../router'
import type { RelumeViewer } from '../viewer/element'
import { recorded } from '../viewer/photographed'

/** Width and height of the frame in the curl command, pixels. */
const COMMAND_SIZE = 1024

export function ModelPage({ id, query }: { id: string; query: URLSearchParams }) {
  const { data: model, error } = useLoaded<Model>(`v1/models/${encodeURIComponent(id)}`)
  const lights = useLoaded<Environments>('v1/environments?limit=100')
  const [look, setLook] = useState<Look>(() => readLook(query))
  const [view, setView] = useState<View>()
  const [failed, setFailed] = useState<string>()
  useTitle(model ? called(model, 'Model') : 'Model')
  const change = (some: Partial<Look>) => setLook((before) => ({ ...before, ...some }))
  useEffect(() => {
    const wait = setTimeout(() => describe(['models', id], written(look, view)), 200)
    return () => clearTimeout(wait)
  }, [id, look, view])
  const discard = () => {
    if (!confirm('Delete this model and its files?')) return
    remove(`v1/models/${encodeURIComponent(id)}`).then(() => go(link(['models'])), (failure: unknown) => setFailed(message(failure)))
  }
  return (
    <>
      <Head title={model ? called(model, 'Model') : 'Model'} back={{ to: link(['models']), label: 'Models' }} note={model ? <>{count(model.gaussians)} Gaussians · <a href={link(['jobs', model.job])}>training</a> · <a href={link(['captures', model.capture])}>capture</a></> : null}>
        <button type="button" class="quiet danger" onClick={discard}>Delete</button>
      </Head>
      <Failure error={error ?? failed} />
      {model ? (
        <div class="viewing">
          <div class="stack">
            <Theatre model={model} look={look} query={query} lights={lights.data} onView={setView} view={view} />
            <section class="card stack" aria-labelledby="wipe">
              <h2 id="wipe">Against a photograph</h2>
              <Wipe model={id} capture={model.capture} look={look} lights={lights.data} />
            </section>
          </div>
          <div class="stack">
            <section class="card stack" aria-label="Look">
              <Lights model={id} value={look.light} lights={lights.data} onChange={(light) => change({ light })} onAdded={lights.reload} />
              <Slider label="Turn of the light" value={look.rotation} min={-180} max={180} step={5} unit="°" onInput={(rotation) => change({ rotation })} />
              <Slider label="Exposure" value={look.exposure} min={-4} max={4} step={0.25} unit=" EV" onInput={(exposure) => change({ exposure })} />
              <Background value={look.background} onChange={(background) => change({ background })} />
              <Choices legend="Layer" name="output" pills value={look.output} of={OUTPUTS.map((value) => ({ value, label: value }))} onChange={(output) => change({ output })} />
            </section>
            <Figures of={model} />
            <TakeAlong model={model.id} look={look} view={view} lights={lights.data} />
            <Files of={model} onError={setFailed} />
          </div>
        </div>
      ) : null}
    </>
  )
}

/** The viewer and the actions on its picture. */
function Theatre(props: { model: Model; look: Look; query: URLSearchParams; lights: Environments | undefined; view: View | undefined; onView: (view: View) => void }) {
  const { model, look, lights, view, onView } = props
  const viewer = useRef<RelumeViewer>(null)
  // The initial camera comes from the URL; later the viewer reports its camera.
  const [start] = useState(() => readView(props.query))
  const [mode, setMode] = useState<string>()
  const [turning, setTurning] = useState(false)
  const [marked, setMarked] = useState(true)
  const [error, setError] = useState<string>()
  const [told, setTold] = useState('')
  useEffect(() => {
    const element = viewer.current
    if (!element) return
    const stop = new AbortController()
    const on = (name: string, handler: (detail: unknown) => void) => element.addEventListener(name, (event) => handler((event as CustomEvent<unknown>).detail), { signal: stop.signal })
    const seen = () => onView(element.camera())
    on('relume-view', seen)
    on('relume-ready', seen)
    on('relume-mode', (detail) => setMode(String(detail)))
    on('relume-error', (detail) => setError((detail as { message?: string } | null)?.message ?? String(detail)))
    return () => stop.abort()
  }, [onView])
  useEffect(() => setError(undefined), [look])
  const act = (work: Promise<string>) => work.then(setTold, (failure: unknown) => setError(message(failure)))
  const command = view && lights ? curl(address(`v1/models/${model.id}/render`), requestOf(look, view, lights.builtin, [COMMAND_SIZE, COMMAND_SIZE]), Boolean(apiKey())) : ''
  const keep = async () => {
    if (!viewer.current) return ''
    save(await viewer.current.snapshot(), `${called(model, 'model').replace(/[^\w.-]+/g, '-')}.png`)
    return 'The frame was saved'
  }
  const copy = async (text: string, what: string) => {
    // Browsers provide a clipboard only on localhost and over https.
    if (!window.isSecureContext) throw new Error('this page cannot copy without https; select the text instead')
    await navigator.clipboard.writeText(text)
    return `${what} was copied`
  }
  return (
    <section class="theatre" aria-label="Viewer">
      <div class="frame">
        <relume-viewer
          ref={viewer}
          model={model.id}
          environment={look.light}
          rotation={String(look.rotation)}
          exposure={String(look.exposure)}
          background={backgroundOf(look)}
          output={look.output}
          auto-rotate={turning ? '' : undefined}
          photographed={marked ? '' : undefined}
          apiKey={apiKey()}
          {...start}
        />
        {mode ? <span class="mode">{mode === 'webgpu' ? 'drawn here, by WebGPU' : 'drawn by the server'}</span> : null}
      </div>
      <div class="bar">
        <button type="button" onClick={() => void act(keep())}>Save the frame</button>
        <button type="button" onClick={() => void act(copy(location.href, 'The link'))}>Copy the link</button>
        <button type="button" aria-pressed={turning} onClick={() => setTurning(!turning)}>{turning ? 'Stop turning' : 'Turn'}</button>
        {recorded(model.card) ? <button type="button" aria-pressed={marked} onClick={() => setMarked(!marked)}>Photographed directions</button> : null}
        <span class="hint">Drag or arrow keys turn, wheel or + − approach</span>
      </div>
      <p class="small muted" role="status">{told}</p>
      <Failure error={error} />
      <details>
        <summary>As a command</summary>
        <div class="stack">
          <pre tabIndex={0} aria-label="Command">{command}</pre>
          <div class="row"><button type="button" onClick={() => void act(copy(command, 'The command'))}>Copy the command</button></div>
        </div>
      </details>
    </section>
  )
}

function Background({ value, onChange }: { value: string; onChange: (background: string) => void }) {
  const isColour = value.startsWith('#')
  const of = [{ value: 'transparent', label: 'none' }, { value: 'environment', label: 'the light' }, { value: 'colour', label: 'a colour' }]
  return (
    <div class="row">
      <Choices legend="Background" name="background" pills value={isColour ? 'colour' : value} of={of} onChange={(chosen) => onChange(chosen === 'colour' ? '#f4f1ea' : chosen)} />
      {isColour ? <input type="color" aria-label="Colour of the background" value={value} onInput={(event) => onChange(event.currentTarget.value)} /> : null}
    </div>
  )
}

/** The fields of a model card that the page shows. */
interface Card {
  figures?: { novel_view?: { psnr?: number; ssim?: number } }
  training_seconds?: number
  steps?: number
  photographs?: number
  engine?: string
  config?: { preset?: string }
}

function Figures({ of: model }: { of: Model }) {
  const card = model.card as Card
  return (
    <section class="card" aria-labelledby="card">
      <h2 id="card">Figures</h2>
      <Facts of={[
        ['Held-out PSNR', decibels(card.figures?.novel_view?.psnr)],
        ['SSIM', share(card.figures?.novel_view?.ssim)],
        ['Preset', card.config?.preset ?? '–'],
        ['Steps', count(card.steps)],
        ['Photographs', count(card.photographs)],
        ['Training', duration(card.training_seconds)],
      ]} />
    </section>
  )
}

function Files({ of: model, onError }: { of: Model; onError: (error: string) => void }) {
  // `fetch` sends the API key; a link does not.
  const fetchFile = (href: string, name: string) => ask(href).then((answer) => answer.blob()).then((blob) => save(blob, name), (error: unknown) => onError(message(error)))
  return (
    <section class="card" aria-labelledby="files">
      <h2 id="files">Files</h2>
      <ul class="notices">
        {model.files.map((file) => (
          <li class="row" key={file.name}>
            <button type="button" onClick={() => void fetchFile(file.href, file.name)}>↓ {file.name}</button>
            <span class="muted small">{bytes(file.bytes)}</span>
          </li>
        ))}
      </ul>
    </section>
  )
}
