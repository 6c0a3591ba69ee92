import { useEffect, useState } from 'preact/hooks'
import { ask, message } from '../api/client'
import type { Camera, Cameras, Environments, RenderRequest } from '../api/types'
import { useLoaded } from '../hooks'
import { requestAt, type Look } from '../look'
import { photograph } from '../photos'
import { Failure, Slider } from './common'

/** Longest side of the two pictures, pixels. */
const SIZE = 640

/** A photograph's own view before and after relighting, with a slider between the two. */
export function Wipe({ model, capture, look, lights }: { model: string; capture: string; look: Look; lights: Environments | undefined }) {
  const cameras = useLoaded<Cameras>(`v1/captures/${encodeURIComponent(capture)}/cameras?convention=opengl`)
  const [name, setName] = useState<string>()
  const [cut, setCut] = useState(50)
  const list = cameras.data?.cameras ?? []
  const camera = list.find((one) => one.name === name) ?? list.find((one) => one.held_out) ?? list[0]
  const builtin = lights?.builtin ?? []
  const taken = useTaken(camera ? photograph(capture, camera.name) : undefined)
  const before = useFrame(model, camera && !taken ? requestAt({ ...look, light: 'recovered', rotation: 0, exposure: 0 }, camera, builtin, SIZE) : undefined)
  const after = useFrame(model, camera && lights ? requestAt(look, camera, builtin, SIZE) : undefined)
  if (cameras.error) return <p class="muted small">The capture of this model is gone, and with it the cameras of its photographs.</p>
  if (!camera) return null
  return (
    <div class="stack">
      <figure class="wipe" style={{ '--cut': `${cut}%`, '--aspect': `${camera.width / camera.height}` }}>
        <img src={taken ?? before.url ?? ''} alt={taken ? `Photograph ${camera.name}` : `${camera.name} under the light of the capture`} hidden={!taken && !before.url} />
        {after.url ? <div class="after"><img src={after.url} alt={`${camera.name} under the chosen light`} /></div> : null}
        <figcaption class="left">{taken ? 'photograph' : 'light of the capture'}</figcaption>
        <figcaption class="right">chosen light</figcaption>
      </figure>
      <Slider label="Before and after" value={cut} min={0} max={100} step={1} unit=" %" onInput={setCut} />
      <div>
        <label for="photograph">Photograph</label>
        <select id="photograph" value={camera.name} onChange={(event) => setName(event.currentTarget.value)}>
          {list.map((one: Camera) => <option key={one.name} value={one.name}>{one.name}{one.held_out ? ' (held out)' : ''}</option>)}
        </select>
      </div>
      <Failure error={before.error ?? after.error} />
    </div>
  )
}

/** An address for a file of this tab. */
function useTaken(file: File | undefined): string | undefined {
  const [url, setUrl] = useState<string>()
  useEffect(() => {
    if (!file) return setUrl(undefined)
    const made = URL.createObjectURL(file)
    setUrl(made)
    return () => URL.revokeObjectURL(made)
  }, [file])
  return url
}

/** The frame of a request; the one before stays until it has come. */
function useFrame(model: string, request: RenderRequest | undefined): { url?: string; error?: string } {
  const [shown, setShown] = useState<{ url?: string; error?: string }>({})
  const body = request ? JSON.stringify(request) : undefined
  useEffect(() => {
    if (!body) return
    const stop = new AbortController()
    const wait = setTimeout(() => {
      ask(`v1/models/${model}/render`, { method: 'POST', body, signal: stop.signal, headers: { 'Content-Type': 'application/json', Accept: 'image/png' } })
        .then((answer) => answer.blob())
        .then((blob) => setShown({ url: URL.createObjectURL(blob) }))
        .catch((error: unknown) => {
          if (!stop.signal.aborted) setShown({ error: message(error) })
        })
    }, 250)
    return () => {
      clearTimeout(wait)
      stop.abort()
    }
  }, [model, body])
  useEffect(() => () => {
    if (shown.url) URL.revokeObjectURL(shown.url)
  }, [shown])
  return shown
}
