// The extension makes the published types resolvable for programs of Node's module resolution.
import type { Engine, EngineListener, ViewerMode } from './engine.js'
import { Frames, type Look } from './frames'
import { LiveView } from './live'
import { eye, fitted, Orbit, type OrbitView } from './orbit.js'
import { PhotographedMap } from './photographed'
import { ServedView } from './served'

export type { ViewerMode } from './engine.js'

/** The detail of the event `relume-view`: the camera with its position `eye`, in degrees and capture units. */
export interface ViewDetail extends OrbitView {
  eye: [number, number, number]
}

const SHEET = new CSSStyleSheet()
SHEET.replaceSync(`
  :host { display: block; position: relative; aspect-ratio: 4 / 3; min-height: 8rem; touch-action: pan-y; }
  :host(:focus-visible) { outline: 2px solid currentColor; outline-offset: 2px; }
  img, canvas { position: absolute; inset: 0; width: 100%; height: 100%; object-fit: contain; user-select: none; transition: opacity 0.15s; }
  .waiting { opacity: 0.35; transition: opacity 0.3s 0.2s; }
  .photographed { position: absolute; right: 0.5rem; bottom: 0.5rem; width: 6rem; margin: 0; pointer-events: none; text-align: center; }
  .photographed svg { width: 4rem; height: 4rem; }
  .photographed figcaption { font: 0.7rem/1.2 system-ui, sans-serif; color: #fff; background: #000a; border-radius: 0.25rem; padding: 0.1rem 0.3rem; overflow-wrap: anywhere; }
  .photographed.guess figcaption { background: #a30; }
  .sphere { fill: #0006; stroke: #fff; stroke-width: 2; }
  .seen { fill: #6c6; opacity: 0.6; }
  .horizon { fill: none; stroke: #fff8; stroke-width: 2; }
  .camera { fill: #fff; stroke: #000; stroke-width: 3; }
`)

/** Rotation of `auto-rotate`: degrees per second, and maximum degrees per picture. */
const SPIN = 30
const MOST_TURN = 3

const NUMBERS = ['azimuth', 'elevation', 'distance', 'fov'] as const
const CAMERA: readonly string[] = [...NUMBERS, 'target']

/**
 * `<relume-viewer model="ID">`: shows a model of a Relume server. The page sets the light, and the user rotates the model.
 *
 * Attributes: `server`, `model`, `environment` (a built-in map, `recovered` or an identifier), `rotation` (degrees), `exposure` (stops),
 * `background` (`transparent`, `environment` or `#rrggbb`), `output` (`rgb`, `albedo`, `normal`, `roughness`, `metalness`, `ao`, `depth`),
 * `auto-rotate`, `photographed` (a map of the photographed directions), `azimuth` (degrees from the first photograph), `elevation` (degrees),
 * `distance` (capture units), `fov` (degrees, vertical), `target` (the point at which the camera looks: `x,y,z`, capture units).
 * Events: `relume-ready`, `relume-view`, `relume-mode`, `relume-progress`, `relume-waiting`, `relume-error`.
 */
export class RelumeViewer extends HTMLElement {
  static readonly observedAttributes = [
    'server', 'model', 'environment', 'rotation', 'exposure', 'background', 'output', 'auto-rotate', 'photographed', ...CAMERA,
  ]

  readonly #root = this.attachShadow({ mode: 'open' })
  readonly #orbit = new Orbit(this, {
    changed: () => this.#moved(),
    initial: () => this.#initial(),
    pick: (x, y) => this.#engine?.pick(this.camera(), x, y),
  })
  readonly #resized = new ResizeObserver(() => this.#draw(false))
  #frames: Frames | undefined
  #engine: Engine | undefined
  #map: PhotographedMap | undefined
  #apiKey: string | undefined
  #share: string | undefined
  /** Time of the last rotation of `auto-rotate`, milliseconds. */
  #turned = 0

  constructor() {
    super()
    this.#root.adoptedStyleSheets = [SHEET]
  }

  /** An API key of the server. The viewer sends it with every request. */
  get apiKey(): string | undefined {
    return this.#apiKey
  }

  set apiKey(key: string | undefined) {
    this.#apiKey = key
    if (this.isConnected) void this.#open()
  }

  /** The query of the model's share page. The viewer sends it with every request, in place of a key. */
  get share(): string | undefined {
    return this.#share
  }

  set share(query: string | undefined) {
    this.#share = query
    if (this.isConnected) void this.#open()
  }

  connectedCallback(): void {
    if (!this.hasAttribute('tabindex')) this.tabIndex = 0
    if (!this.hasAttribute('role')) this.setAttribute('role', 'application')
    if (!this.hasAttribute('aria-label')) this.setAttribute('aria-label', '3D view: turn with the arrow keys, move with Shift and the arrow keys, approach with + and -, Home resets')
    this.#orbit.listen()
    this.#resized.observe(this)
    void this.#open()
  }

  disconnectedCallback(): void {
    this.#orbit.unlisten()
    this.#resized.disconnect()
    this.#close()
  }

  attributeChangedCallback(name: string, before: string | null, after: string | null): void {
    if (before === after || !this.isConnected) return
    if (name === 'model' || name === 'server') void this.#open()
    else {
      if (CAMERA.includes(name)) this.#readView()
      this.#draw(false)
    }
  }

  /** The current camera. */
  camera(): ViewDetail {
    const view = this.#orbit.view()
    return { ...view, eye: eye(view) }
  }

  /** Returns to the initial camera of the model. */
  reset(): void {
    this.#orbit.reset()
  }

  /** Shows the whole model from another direction: the initial camera with this azimuth and elevation (degrees), and this distance (capture units) if it is given. */
  turnTo(azimuth: number, elevation: number, distance?: number): void {
    this.#orbit.set({ ...this.#initial(), azimuth, elevation, ...(distance === undefined ? {} : { distance }) })
    this.#moved()
  }

  /** The current picture at full quality as a PNG. Rejects if no model is shown. */
  async snapshot(): Promise<Blob> {
    if (!this.#engine) throw new Error('no model is shown')
    return this.#engine.snapshot(this.#look(), this.camera())
  }

  #server(): string {
    const given = this.getAttribute('server')
    if (given) return given.replace(/\/*$/, '/')
    if (import.meta.env.DEV) return new URL('./', document.baseURI).href
    // The folder of the viewer's script; this code may be in a chunk below assets/.
    return import.meta.url.replace(/(assets\/)?[^/]*$/, '')
  }

  async #open(): Promise<void> {
    this.#close()
    const model = this.getAttribute('model')
    if (!model) return
    const frames = new Frames(this.#server(), model, { apiKey: this.#apiKey, share: this.#share })
    this.#frames = frames
    try {
      const live = await LiveView.open(frames, this.#listener(frames))
      if (this.#frames === frames) await this.#begin(frames, live)
      else live?.close()
    } catch (error) {
      if (this.#frames === frames) this.#fail(error)
    }
  }

  /** Draws with `live`, or with frames of the server without it. */
  async #begin(frames: Frames, live?: Engine): Promise<void> {
    const engine = live ?? (await ServedView.open(frames, this.#listener(frames), this.camera().fov))
    if (this.#frames !== frames) return engine.close()
    const before = this.#engine
    this.#engine = engine
    // An engine that replaces another keeps the current camera.
    if (!before) this.#orbit.set(this.#initial())
    before?.close()
    this.#map = undefined
    this.#root.replaceChildren(engine.node)
    this.#readView()
    this.#fire('relume-mode', engine.mode)
    this.#draw(false)
  }

  /** The initial view of the model. The subject also fits into an element that is narrower than high. */
  #initial(): Partial<OrbitView> {
    const { begin, photographed } = this.#engine ?? {}
    if (!begin || !photographed) return { ...begin }
    return fitted(begin, this.clientWidth / Math.max(1, this.clientHeight))
  }

  #close(): void {
    this.#frames?.close()
    this.#frames = undefined
    this.#engine?.close()
    this.#engine = undefined
  }

  #listener(frames: Frames): EngineListener {
    return {
      size: () => [this.clientWidth, this.clientHeight],
      ready: () => this.#fire('relume-ready', undefined),
      shown: () => this.#spin(),
      loaded: (bytes, total) => {
        if (this.#frames === frames) this.#fire('relume-progress', { bytes, total })
      },
      waiting: (isWaiting) => this.#wait(isWaiting),
      failed: (error) => this.#fail(error),
      lost: () => {
        if (this.#frames === frames) this.#begin(frames).catch((error: unknown) => this.#fail(error))
      },
    }
  }

  #readView(): void {
    const view: Partial<OrbitView> = {}
    for (const name of NUMBERS) {
      const value = this.getAttribute(name)
      if (value !== null && Number.isFinite(Number(value))) view[name] = Number(value)
    }
    const target = this.getAttribute('target')?.split(',').map(Number)
    if (target?.length === 3 && target.every(Number.isFinite)) view.target = target as OrbitView['target']
    this.#orbit.set(view)
  }

  #look(): Look {
    const given = (name: string, otherwise: string) => this.getAttribute(name) ?? otherwise
    return {
      environment: given('environment', 'recovered'),
      rotation: Number(given('rotation', '0')) || 0,
      exposure: Number(given('exposure', '0')) || 0,
      background: given('background', 'transparent'),
      output: given('output', 'rgb'),
    }
  }

  #moved(): void {
    this.#fire('relume-view', this.camera())
    this.#draw(true)
  }

  /** Shows, updates or removes the map of the photographed directions. */
  #mark(): void {
    const views = this.hasAttribute('photographed') ? this.#engine?.photographed : undefined
    if (this.#map && this.#map.views !== views) {
      this.#map.node.remove()
      this.#map = undefined
    }
    if (!views) return
    this.#map ??= new PhotographedMap(views)
    if (!this.#map.node.isConnected) this.#root.append(this.#map.node)
    this.#map.show(this.camera())
  }

  #draw(moving: boolean): void {
    this.#mark()
    this.#engine?.draw(this.#look(), this.camera(), moving && this.hasAttribute('auto-rotate'))
  }

  /** Dims the picture of the previous light until that of the chosen one has arrived. */
  #wait(isWaiting: boolean): void {
    const node = this.#engine?.node
    if (!node || node.classList.contains('waiting') === isWaiting) return
    node.classList.toggle('waiting', isWaiting)
    this.#fire('relume-waiting', isWaiting)
  }

  /** Rotates the camera by one step of `auto-rotate`. */
  #spin(): void {
    if (!this.hasAttribute('auto-rotate')) return
    const now = performance.now()
    const turn = Math.min(MOST_TURN, ((now - this.#turned) / 1000) * SPIN)
    this.#turned = now
    this.#orbit.turn(turn)
  }

  #fail(error: unknown): void {
    if (error instanceof DOMException && error.name === 'AbortError') return
    this.#fire('relume-error', { message: error instanceof Error ? error.message : String(error) })
  }

  #fire(name: string, detail: unknown): void {
    this.dispatchEvent(new CustomEvent(name, { detail, bubbles: true, composed: true }))
  }
}

declare global {
  interface HTMLElementTagNameMap {
    'relume-viewer': RelumeViewer
  }
  interface HTMLElementEventMap {
    'relume-mode': CustomEvent<ViewerMode>
    'relume-ready': CustomEvent<unknown>
    'relume-view': CustomEvent<ViewDetail>
    'relume-progress': CustomEvent<{ bytes: number; total: number | undefined }>
    'relume-waiting': CustomEvent<boolean>
    'relume-error': CustomEvent<{ message: string }>
  }
}

if (!customElements.get('relume-viewer')) customElements.define('relume-viewer', RelumeViewer)
