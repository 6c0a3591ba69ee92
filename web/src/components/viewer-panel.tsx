import type { RefObject } from 'preact'
import { useEffect, useRef, useState } from 'preact/hooks'
import { address, apiKey, post } from '../api/client'
import { explain, type PageError } from '../api/page-error'
import type { Environments, Model, SignedUrl } from '../api/types'
import { bytes, called } from '../format'
import { backgroundOf, curl, readView, requestOf, written, type Look, type View } from '../look'
import type { RelumeViewer } from '../viewer/element'
import { recorded } from '../viewer/photographed'
import { Failure, Picture, save } from './common'
import { LightDial } from './dial'

/** Width and height of the frame in the curl command, pixels. */
const COMMAND_SIZE = 1024
/** Life of the link to share, seconds. */
const SHARED_FOR = 7 * 24 * 3600

interface ViewerPanelProps {
  /** Gets the viewer's element. */
  viewer: RefObject<RelumeViewer | null>
  model: Model
  look: Look
  query: URLSearchParams
  lights: Environments | undefined
  view: View | undefined
  onView: (view: View, isFirst: boolean) => void
  onRotation: (degrees: number) => void
}

interface Arrived {
  bytes: number
  total: number | undefined
}

/** What the events of the viewer's element have told. */
function useViewer(viewer: ViewerPanelProps['viewer'], onView: ViewerPanelProps['onView']) {
  const [mode, setMode] = useState<string>()
  const [isReady, setReady] = useState(false)
  const [isWaiting, setWaiting] = useState(false)
  const [arrived, setArrived] = useState<Arrived>()
  const [error, setError] = useState<PageError>()
  useEffect(() => {
    const element = viewer.current
    if (!element) return
    const stop = new AbortController()
    const on = <T,>(name: string, handler: (detail: T) => void) => element.addEventListener(name, (event) => handler((event as CustomEvent<T>).detail), { signal: stop.signal })
    on('relume-view', () => onView(element.camera(), false))
    on('relume-ready', () => {
      setReady(true)
      onView(element.camera(), false)
    })
    on<string>('relume-mode', (mode) => {
      setMode(mode)
      onView(element.camera(), true)
    })
    on<Arrived>('relume-progress', setArrived)
    on<boolean>('relume-waiting', setWaiting)
    on<{ message: string }>('relume-error', ({ message }) => setError({ what: 'The viewer cannot show this.', remedy: 'Try again, or choose another light.', detail: message }))
    return () => stop.abort()
  }, [viewer, onView])
  return { mode, isReady, isWaiting, arrived, error, setError }
}

/** The viewer and the actions on its picture. */
export function ViewerPanel({ viewer, model, look, query, lights, view, onView, onRotation }: ViewerPanelProps) {
  const frame = useRef<HTMLDivElement>(null)
  // The initial camera comes from the URL; later the viewer reports its camera.
  const [start] = useState(() => readView(query))
  const { mode, isReady, isWaiting, arrived, error, setError } = useViewer(viewer, onView)
  const [turning, setTurning] = useState(false)
  const [marked, setMarked] = useState(true)
  const [told, setTold] = useState('')
  useEffect(() => setError(undefined), [look, setError])
  const act = (work: Promise<string>) => work.then(setTold, (failure: unknown) => setError(explain(failure)))
  const keep = async () => {
    if (!viewer.current) return ''
    save(await viewer.current.snapshot(), `${called(model, 'model').replace(/[^\w.-]+/g, '-')}.png`)
    return 'The picture was saved'
  }
  const again = () => {
    setError(undefined)
    // Another key, even the same, makes the viewer load again.
    if (viewer.current) viewer.current.apiKey = apiKey()
  }
  return (
    <section class="viewer-panel" aria-label="Viewer">
      <div class="frame" ref={frame}>
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
        {isReady || error ? null : <Poster model={model.id} light={look.light} arrived={arrived} />}
        {isWaiting && isReady ? <div class="poster late"><p><span class="spinner" />The light is on its way</p></div> : null}
        <div class="corner">
          <button type="button" onClick={() => viewer.current?.reset()}>Reset the view</button>
          {document.fullscreenEnabled ? <button type="button" onClick={() => void (document.fullscreenElement ? document.exitFullscreen() : frame.current?.requestFullscreen())}>Full screen</button> : null}
        </div>
        <LightDial value={look.rotation} onChange={onRotation} />
      </div>
      <div class="bar">
        <button type="button" onClick={() => void act(keep())}>Save the picture</button>
        <button type="button" onClick={() => void act(copy(location.href, 'The link'))}>Copy the link</button>
        <button type="button" title="A page with this model alone, for people without a key" onClick={() => void act(shared(model.id, look, view))}>Copy a link to share</button>
        <button type="button" aria-pressed={turning} onClick={() => setTurning(!turning)}>{turning ? 'Stop turning' : 'Turn'}</button>
        {recorded(model.card) ? <button type="button" aria-pressed={marked} onClick={() => setMarked(!marked)}>Photographed directions</button> : null}
      </div>
      <p class="hint">Drag to turn, Shift and drag or two fingers to move, wheel or pinch to come closer, double click to look at a point. Drag the sun to turn the light.{mode ? <span class="mode"> {mode === 'webgpu' ? 'This browser draws the model.' : 'The server draws the model.'}</span> : null}</p>
      <p class="small muted" role="status">{told}</p>
      <Failure error={error} retry={again} />
      <Snippets model={model} look={look} view={view} lights={lights} onCopy={(text, what) => void act(copy(text, what))} />
    </section>
  )
}

/** The picture of the model while the viewer loads, and how much of it has arrived. */
function Poster({ model, light, arrived }: { model: string; light: string; arrived: Arrived | undefined }) {
  const isWhole = arrived && arrived.bytes === arrived.total
  const text = !arrived || isWhole ? 'The light is on its way' : `${bytes(arrived.bytes)}${arrived.total ? ` of ${bytes(arrived.total)}` : ''}`
  return (
    <div class="poster">
      <Picture path={`v1/models/${model}/thumbnail?size=512&env=${encodeURIComponent(light)}`} alt="" />
      <p role="status"><span class="spinner" />{arrived ? text : 'The model is being loaded'}</p>
    </div>
  )
}

/** Copies the link of the page that shows only this model. With a key the link is signed. */
async function shared(model: string, look: Look, view: View | undefined): Promise<string> {
  const path = `/share/${encodeURIComponent(model)}?${new URLSearchParams(written(look, view, undefined))}`
  if (!apiKey()) return copy(address(path), 'The link to share')
  const { url } = await post<SignedUrl>('v1/signed-urls', { path, expires_in: SHARED_FOR })
  await copy(address(url), 'The link to share')
  return 'The link to share was copied. Whoever has it sees this model without a key, for 7 days or until the key is revoked'
}

async function copy(text: string, what: string): Promise<string> {
  // Browsers provide a clipboard only on localhost and over https.
  if (!window.isSecureContext) throw new Error('This page cannot copy without https. Select the text instead.')
  await navigator.clipboard.writeText(text)
  return `${what} was copied`
}

/** The element for another page, and the current picture as a command. */
function Snippets({ model, look, view, lights, onCopy }: { model: Model; look: Look; view: View | undefined; lights: Environments | undefined; onCopy: (text: string, what: string) => void }) {
  const command = view && lights ? curl(address(`v1/models/${model.id}/render`), requestOf(look, view, lights.builtin, [COMMAND_SIZE, COMMAND_SIZE]), Boolean(apiKey())) : ''
  const element = embed(model.id, look)
  return (
    <>
      <details>
        <summary>Embed</summary>
        <div class="stack">
          <p class="small muted">Put this into the HTML of your page. The operator of the server must allow the page with <code>--cors-origin</code>{apiKey() ? <>, and the page needs a key with the scopes <code>read</code> and <code>render</code> in the property <code>apiKey</code> of the element</> : null}.</p>
          <pre tabIndex={0} aria-label="HTML">{element}</pre>
          <div class="row"><button type="button" onClick={() => onCopy(element, 'The HTML')}>Copy the HTML</button></div>
        </div>
      </details>
      <details>
        <summary>As a command</summary>
        <div class="stack">
          <pre tabIndex={0} aria-label="Command">{command}</pre>
          <div class="row"><button type="button" onClick={() => onCopy(command, 'The command')}>Copy the command</button></div>
        </div>
      </details>
    </>
  )
}

/** The HTML that shows a model on another page with the look of this one. */
function embed(model: string, look: Look): string {
  const given: [string, string][] = [['model', model], ['environment', look.light]]
  if (look.rotation) given.push(['rotation', String(look.rotation)])
  if (look.exposure) given.push(['exposure', String(look.exposure)])
  if (look.background !== 'transparent') given.push(['background', backgroundOf(look)])
  if (look.output !== 'rgb') given.push(['output', look.output])
  const attributes = given.map(([name, value]) => `${name}="${value}"`).join(' ')
  return `<script type="module" src="${address('relume-viewer.js')}"></script>\n<relume-viewer ${attributes} style="width: 100%; height: 480px"></relume-viewer>`
}
