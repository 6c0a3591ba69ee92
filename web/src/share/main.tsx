/** The page `share/ID`: one model, its light and its viewer, for people without a key. */
import { render } from 'preact'
import { useEffect, useRef, useState } from 'preact/hooks'
import { LightDial } from '../components/dial'
import { backgroundOf, readLook, readView, SHARED_LIGHTS } from '../look'
import type { RelumeViewer } from '../viewer/element'
import '../viewer/element'
import '../styles/base.css'
import '../styles/controls.css'
import '../styles/pages.css'
import './share.css'

const query = new URLSearchParams(location.search)
const model = decodeURIComponent(location.pathname.replace(/\/$/, '').split('/').pop() ?? '')
/** The credentials of the page's requests. A server without keys needs none. */
const share = query.has('signature') ? location.search.slice(1) : undefined
/** The server puts the name of the model into the title of a page whose link is valid. */
const name = document.title
if (!name) document.title = 'This link shows no model'

function SharedModel() {
  const viewer = useRef<RelumeViewer>(null)
  const [start] = useState(() => readView(query))
  const [look, setLook] = useState(() => readLook(query))
  const [isReady, setReady] = useState(false)
  const [canTurn, setCanTurn] = useState(false)
  const [failed, setFailed] = useState('')
  useEffect(() => {
    const element = viewer.current
    if (!element) return
    const stop = new AbortController()
    const on = (name: string, act: (event: CustomEvent) => void) => element.addEventListener(name, (event) => act(event as CustomEvent), { signal: stop.signal })
    on('relume-ready', () => setReady(true))
    // Pictures of the server, in place of WebGPU, have the light in its own direction only.
    on('relume-mode', ({ detail }) => setCanTurn(detail === 'webgpu'))
    on('relume-error', ({ detail }) => setFailed((detail as { message: string }).message))
    return () => stop.abort()
  }, [])
  const lights = SHARED_LIGHTS.some(([light]) => light === look.light) ? SHARED_LIGHTS : [[look.light, 'as shared'] as const, ...SHARED_LIGHTS]
  if (!name) return <Invalid />
  return (
    <main class="shared">
      <h1>{name}</h1>
      <section class="viewer-panel" aria-label="Viewer">
        <div class="frame">
          <relume-viewer
            ref={viewer}
            model={model}
            environment={look.light}
            rotation={String(look.rotation)}
            exposure={String(look.exposure)}
            background={backgroundOf(look)}
            output={look.output}
            share={share}
            {...start}
          />
          {isReady || failed ? null : <div class="poster"><p role="status"><span class="spinner" />The model is being loaded</p></div>}
          <div class="corner"><button type="button" onClick={() => viewer.current?.reset()}>Reset the view</button></div>
          {canTurn ? <LightDial value={look.rotation} onChange={(rotation) => setLook({ ...look, rotation })} /> : null}
        </div>
        {failed ? <p role="alert" class="card">The model cannot be shown: {failed}. <button type="button" onClick={() => location.reload()}>Try again</button></p> : null}
        <div class="bar" role="group" aria-label="Light">
          {lights.map(([light, label]) => (
            <button type="button" key={light} aria-pressed={light === look.light} onClick={() => setLook({ ...look, light })}>{label}</button>
          ))}
        </div>
        <p class="hint">Drag to turn{canTurn ? ', wheel or pinch to come closer, double click to look at a point. Drag the sun to turn the light' : ''}.</p>
      </section>
    </main>
  )
}

function Invalid() {
  return (
    <main class="shared">
      <section class="card stack">
        <h1>This link shows no model</h1>
        <p>The link has expired, was changed, or its model was deleted. Ask the person who sent it for a new one.</p>
      </section>
    </main>
  )
}

const root = document.getElementById('share')
if (root) render(<SharedModel />, root)
