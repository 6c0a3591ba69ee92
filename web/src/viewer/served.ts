import type { Engine, EngineListener } from './engine'
import type { Frames, Look } from './frames'
import { release } from '../object-url'
import type { OrbitView } from './orbit'
import { firstView, type PhotographedViews } from './photographed'

/** Sizes of frames, as the side of a square with as many pixels: while the camera moves, when it rests, and a while later. */
const MOVING = 256
const RESTING = 1024
const SHARPEST = 2560
/** Longest side of a frame that the API renders, pixels. */
const LONGEST = 4096
/** Delay before the viewer requests a sharp frame after the last movement, milliseconds. */
const SETTLE = 180
/** Delay before the viewer requests the sharpest frame after a resting one, milliseconds. */
const SHARPEN = 700

interface Wish {
  look: Look
  view: OrbitView
  most: number
}

/** Shows frames that the server renders. */
export class ServedView implements Engine {
  readonly mode = 'server'
  readonly node = document.createElement('img')
  readonly begin: Partial<OrbitView>
  readonly photographed: PhotographedViews | undefined
  readonly #frames: Frames
  readonly #listener: EngineListener
  #timer = 0
  #closed = false
  #busy = false
  #ready = false
  /** The newest requested picture while a frame is being loaded. */
  #next: Wish | undefined
  /** The light of the shown picture. */
  #light = ''

  private constructor(frames: Frames, listener: EngineListener, begin: Partial<OrbitView>, photographed?: PhotographedViews) {
    this.#frames = frames
    this.#listener = listener
    this.begin = begin
    this.photographed = photographed
    this.node.draggable = false
    this.node.alt = ''
  }

  static async open(frames: Frames, listener: EngineListener, fov: number): Promise<ServedView> {
    const framing = await frames.framing()
    if ('photographs' in framing) return new ServedView(frames, listener, firstView(framing), framing)
    const distance = (1.1 * framing.radius) / Math.sin((fov * Math.PI) / 360)
    return new ServedView(frames, listener, { target: framing.centre, distance, zero: 0 })
  }

  draw(look: Look, view: OrbitView, moving: boolean): void {
    clearTimeout(this.#timer)
    if (this.#ready) this.#listener.waiting(lightOf(look) !== this.#light)
    this.#ask({ look, view, most: this.#ready ? MOVING : RESTING })
    if (!moving && this.#ready) this.#timer = window.setTimeout(() => this.#ask({ look, view, most: RESTING }), SETTLE)
  }

  /** The frame has no depth. */
  pick(): undefined {}

  snapshot(look: Look, view: OrbitView): Promise<Blob> {
    return this.#frames.frame(look, view, this.#size(RESTING))
  }

  close(): void {
    this.#closed = true
    clearTimeout(this.#timer)
    release(this.node.src)
  }

  #ask(wish: Wish): void {
    this.#next = wish
    if (!this.#busy) void this.#work()
  }

  async #work(): Promise<void> {
    this.#busy = true
    try {
      while (this.#next && !this.#closed) {
        const wish = this.#next
        this.#next = undefined
        await this.#show(wish)
      }
    } catch (error) {
      if (!this.#closed) this.#listener.failed(error)
    } finally {
      this.#busy = false
    }
  }

  async #show(wish: Wish): Promise<void> {
    const { look, view, most } = wish
    const blob = await this.#frame(wish)
    if (this.#closed || !blob) return
    const before = this.node.src
    this.node.src = URL.createObjectURL(blob)
    await this.node.decode()
    release(before)
    if (!this.#ready) this.#listener.ready()
    this.#ready = true
    this.#light = lightOf(look)
    this.#listener.waiting(this.#next !== undefined && lightOf(this.#next.look) !== this.#light)
    this.#listener.shown()
    if (most === RESTING && !this.#next && this.#size(SHARPEST)[0] > this.#size(RESTING)[0]) {
      this.#timer = window.setTimeout(() => this.#ask({ look, view, most: SHARPEST }), SHARPEN)
    }
  }

  async #frame({ look, view, most }: Wish): Promise<Blob | undefined> {
    const frame = this.#frames.frame(look, view, this.#size(most), most < RESTING)
    // The server may be too busy for the sharpest frame; the resting one stays.
    return most === SHARPEST ? frame.catch(() => undefined) : frame
  }

  /** The size of a frame with the pixels of a square of side `most` or fewer; never more pixels than the screen shows. */
  #size(most: number): [number, number] {
    const [width, height] = this.#listener.size()
    const scale = Math.min(most / Math.sqrt(Math.max(1, width * height)), LONGEST / Math.max(width, height, 1), window.devicePixelRatio || 1)
    return [Math.max(1, Math.round(width * scale)), Math.max(1, Math.round(height * scale))]
  }
}

function lightOf({ environment, rotation }: Look): string {
  return `${environment} ${rotation}`
}
