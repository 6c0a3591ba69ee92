import { Orbit, type OrbitView } from './orbit'
import { Frames, type Look } from './frames'

/** What is fired as `relume-view`: where the camera stands, degrees and capture units. */
export type ViewDetail = OrbitView

/** Which engine draws. */
export type ViewerMode = 'webgpu' | 'server'

const SHEET = new CSSStyleSheet()
SHEET.replaceSync(`
  :host { display: block; position: relative; min-height: 8rem; touch-action: none; }
  :host(:focus-visible) { outline: 2px solid currentColor; outline-offset: 2px; }
  img { display: block; width: 100%; height: 100%; object-fit: contain; user-select: none; }
`)

/** Longest side of frames while the camera moves, pixels. */
const MOVING = 256
/** Longest side of frames when it rests, pixels. */
const RESTING = 1024
/** Rest before a sharp frame is asked for, milliseconds. */
const SETTLE = 180
/** Turn of `auto-rotate`, degrees per frame that arrives. */
const TURN = 3

const NUMBERS = ['azimuth', 'elevation', 'distance', 'fov'] as const

/**
 * `<relume-viewer model="ID">`: a model of a Relume server, relit and turned by hand.
 *
 * Attributes: `server`, `model`, `environment` (a built-in map, `recovered` or an identifier), `rotation` (degrees), `exposure` (stops),
 * `background` (`transparent`, `environment` or `#rrggbb`), `output` (`rgb`, `albedo`, `normal`, `roughness`, `metalness`, `ao`, `depth`),
 * `auto-rotate`, `azimuth`, `elevation` (degrees), `distance` (capture units), `fov` (degrees, vertical).
 * Events: `relume-ready`, `relume-view`, `relume-mode`, `relume-error`.
 */
export class RelumeViewer extends HTMLElement {
  static readonly observedAttributes = [
    'server', 'model', 'environment', 'rotation', 'exposure', 'background', 'output', 'auto-rotate', ...NUMBERS,
  ]

  readonly #image = document.createElement('img')
  readonly #orbit = new Orbit(this, () => this.#moved())
  #frames: Frames | undefined
  #apiKey: string | undefined
  #timer = 0
  #busy = false
  #stale = false
  #shown: Blob | undefined

  constructor() {
    super()
    const root = this.attachShadow({ mode: 'open' })
    root.adoptedStyleSheets = [SHEET]
    this.#image.draggable = false
    this.#image.alt = ''
    root.append(this.#image)
  }

  /** A key of the server; sent with every request. */
  get apiKey(): string | undefined {
    return this.#apiKey
  }

  set apiKey(key: string | undefined) {
    this.#apiKey = key
    if (this.isConnected) void this.#open()
  }

  connectedCallback(): void {
    if (!this.hasAttribute('tabindex')) this.tabIndex = 0
    if (!this.hasAttribute('role')) this.setAttribute('role', 'application')
    if (!this.hasAttribute('aria-label')) this.setAttribute('aria-label', '3D view: turn with the arrow keys, approach with + and -')
    this.#orbit.listen()
    void this.#open()
  }

  disconnectedCallback(): void {
    this.#orbit.unlisten()
    clearTimeout(this.#timer)
    this.#frames?.close()
    this.#frames = undefined
  }

  attributeChangedCallback(name: string, before: string | null, after: string | null): void {
    if (before === after || !this.isConnected) return
    if (name === 'model' || name === 'server') void this.#open()
    else {
      this.#readView()
      this.#moved(false)
    }
  }

  /** Where the camera stands. */
  camera(): OrbitView {
    return this.#orbit.view()
  }

  /** The frame that is shown, as a PNG. Rejects when there is none yet. */
  async snapshot(): Promise<Blob> {
    if (!this.#frames) throw new Error('no model is shown')
    if (!this.#shown) this.#shown = await this.#frames.frame(this.#look(), this.camera(), this.#size(RESTING))
    return this.#shown
  }

  #server(): string {
    const given = this.getAttribute('server')
    if (given) return given.replace(/\/*$/, '/')
    if (import.meta.env.DEV) return new URL('./', document.baseURI).href
    // Where this script came from, whichever chunk of it this is.
    return import.meta.url.replace(/(assets\/)?[^/]*$/, '')
  }

  async #open(): Promise<void> {
    this.#frames?.close()
    this.#frames = undefined
    const model = this.getAttribute('model')
    if (!model) return
    const frames = new Frames(this.#server(), model, this.#apiKey)
    this.#frames = frames
    try {
      this.#orbit.frame(await frames.framing())
      if (this.#frames !== frames) return
      this.#readView()
      this.#fire('relume-mode', 'server' satisfies ViewerMode)
      await this.#draw(RESTING)
      this.#fire('relume-ready', undefined)
      if (this.hasAttribute('auto-rotate')) this.#moved()
    } catch (error) {
      if (this.#frames === frames) this.#fail(error)
    }
  }

  #readView(): void {
    const view: Partial<OrbitView> = {}
    for (const name of NUMBERS) {
      const value = this.getAttribute(name)
      if (value !== null && Number.isFinite(Number(value))) view[name] = Number(value)
    }
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

  /** The frame's size with a longest side of `most`, never more than the screen has. */
  #size(most: number): [number, number] {
    const { clientWidth, clientHeight } = this
    const pixels = Math.max(clientWidth, clientHeight, 1)
    const scale = Math.min(most / pixels, window.devicePixelRatio || 1)
    return [Math.max(1, Math.round(clientWidth * scale)), Math.max(1, Math.round(clientHeight * scale))]
  }

  #moved(byHand = true): void {
    if (!this.#frames) return
    if (byHand) this.#fire('relume-view', this.camera())
    clearTimeout(this.#timer)
    void this.#draw(MOVING).catch((error: unknown) => this.#fail(error))
    if (!this.hasAttribute('auto-rotate')) {
      this.#timer = window.setTimeout(() => void this.#draw(RESTING).catch((error: unknown) => this.#fail(error)), SETTLE)
    }
  }

  /** Shows a frame. While one is on its way, the newest wish waits for it. */
  async #draw(most: number): Promise<void> {
    const frames = this.#frames
    if (!frames) return
    if (this.#busy) {
      this.#stale = true
      return
    }
    this.#busy = true
    try {
      const blob = await frames.frame(this.#look(), this.camera(), this.#size(most), most < RESTING)
      if (this.#frames !== frames) return
      this.#shown = most === RESTING ? blob : undefined
      const before = this.#image.src
      this.#image.src = URL.createObjectURL(blob)
      await this.#image.decode()
      if (before) URL.revokeObjectURL(before)
    } finally {
      this.#busy = false
    }
    if (this.#stale) {
      this.#stale = false
      this.#moved(false)
    } else if (this.hasAttribute('auto-rotate') && this.#frames === frames) {
      this.#orbit.turn(TURN)
    }
  }

  #fail(error: unknown): void {
    if (error instanceof DOMException && error.name === 'AbortError') return
    this.#fire('relume-error', { message: error instanceof Error ? error.message : String(error) })
  }

  #fire(name: string, detail: unknown): void {
    this.dispatchEvent(new CustomEvent(name, { detail, bubbles: true, composed: true }))
  }
}

if (!customElements.get('relume-viewer')) customElements.define('relume-viewer', RelumeViewer)
