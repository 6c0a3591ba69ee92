import { useEffect, useState } from 'preact/hooks'
import { ask } from '../api/client'
import { explain, type PageError } from '../api/page-error'
import type { Environments, Photograph, Photographs, RenderRequest } from '../api/types'
import { useLoaded } from '../hooks'
import { requestAt, type Look } from '../look'
import { release } from '../object-url'
import { Failure, Slider } from './common'

/** Longest side of both pictures, pixels. */
const SIZE = 640

/** Shows a photograph and a frame of the model from the same camera under the selected light. A slider moves the border between them. */
export function Wipe({ model, capture, look, lights }: { model: string; capture: string; look: Look; lights: Environments | undefined }) {
  const photographs = useLoaded<Photographs>(`v1/captures/${encodeURIComponent(capture)}/photographs?convention=opengl`)
  const [name, setName] = useState<string>()
  const [cut, setCut] = useState(50)
  const list = photographs.data?.photographs ?? []
  const camera = list.find((one) => one.name === name) ?? list.find((one) => one.held_out) ?? list[0]
  const builtin = lights?.builtin ?? []
  const taken = useTaken(camera)
  const before = useFrame(model, camera && taken.isMissing ? requestAt({ ...look, light: 'recovered', rotation: 0, exposure: 0 }, camera, builtin, SIZE) : undefined)
  const after = useFrame(model, camera && lights ? requestAt(look, camera, builtin, SIZE) : undefined)
  if (photographs.error) return <p class="muted small">The capture of this model is gone, and with it the cameras of its photographs.</p>
  if (!camera) return null
  return (
    <div class="stack">
      <figure class="wipe" style={{ '--cut': `${cut}%`, '--aspect': `${camera.width / camera.height}` }}>
        <img src={taken.url ?? before.url ?? ''} alt={taken.isMissing ? `${camera.name} under the light of the capture` : `Photograph ${camera.name}`} hidden={!taken.url && !before.url} />
        {after.url ? <div class="after"><img src={after.url} alt={`${camera.name} under the chosen light`} /></div> : null}
        <figcaption class="left">{taken.isMissing ? 'light of the capture' : 'photograph'}</figcaption>
        <figcaption class="right">chosen light</figcaption>
      </figure>
      <Slider label="Before and after" value={cut} min={0} max={100} step={1} unit=" %" onInput={setCut} />
      <div>
        <label for="photograph">Photograph</label>
        <select id="photograph" value={camera.name} onChange={(event) => setName(event.currentTarget.value)}>
          {list.map((one: Photograph) => <option key={one.name} value={one.name}>{one.name}{one.held_out ? ' (held out)' : ''}</option>)}
        </select>
      </div>
      <Failure error={before.error ?? after.error} />
    </div>
  )
}

/** The undistorted photograph, which matches a frame of its pinhole camera pixel by pixel. `isMissing`: it could not be loaded, and the caller shows a frame instead. */
function useTaken(of: Photograph | undefined): { url?: string; isMissing?: boolean } {
  const [shown, setShown] = useState<{ path?: string; url?: string; isMissing?: boolean }>({})
  const width = of ? Math.max(16, Math.round(of.width * Math.min(1, SIZE / Math.max(of.width, of.height)))) : 0
  const path = of ? `${of.href}?width=${width}&undistorted=true` : undefined
  useEffect(() => {
    if (!path) return
    const stop = new AbortController()
    ask(path, { signal: stop.signal })
      .then((answer) => answer.blob())
      .then((blob) => {
        if (!stop.signal.aborted) setShown({ path, url: URL.createObjectURL(blob) })
      })
      .catch(() => {
        if (!stop.signal.aborted) setShown({ path, isMissing: true })
      })
    return () => stop.abort()
  }, [path])
  useEffect(() => () => {
    release(shown.url)
  }, [shown])
  return shown.path === path ? shown : {}
}

/** The frame of a request. The previous frame stays until the new one has arrived. */
function useFrame(model: string, request: RenderRequest | undefined): { url?: string; error?: PageError } {
  const [shown, setShown] = useState<{ url?: string; error?: PageError }>({})
  const body = request ? JSON.stringify(request) : undefined
  useEffect(() => {
    if (!body) return
    const stop = new AbortController()
    const wait = setTimeout(() => {
      ask(`v1/models/${model}/render`, { method: 'POST', body, signal: stop.signal, headers: { 'Content-Type': 'application/json', Accept: 'image/png' } })
        .then((answer) => answer.blob())
        .then((blob) => setShown({ url: URL.createObjectURL(blob) }))
        .catch((error: unknown) => {
          if (!stop.signal.aborted) setShown({ error: explain(error) })
        })
    }, 250)
    return () => {
      clearTimeout(wait)
      stop.abort()
    }
  }, [model, body])
  useEffect(() => () => {
    release(shown.url)
  }, [shown])
  return shown
}
