import { cameraOf } from './camera'
import { frontPoint } from './pick'
import type { Engine, EngineListener } from './engine'
import type { Frames, Look } from './frames'
import { openDevice } from './gpu/device'
import { Painter, type Finish } from './gpu/painter'
import { makePipelines } from './gpu/pipelines'
import { SceneLight, SceneModel } from './gpu/scene'
import { degrees, type OrbitView } from './orbit'
import { firstView, type PhotographedViews } from './photographed'
import { readStream, type LightHeader, type ModelHeader } from './stream'

/** A requested light. */
interface Lighting {
  key: string
  light: SceneLight
  abort: AbortController
  whole: Promise<void>
}

/** Draws the model in the browser with WebGPU. */
export class LiveView implements Engine {
  readonly mode = 'webgpu'
  readonly node: HTMLCanvasElement
  readonly begin: Partial<OrbitView>
  readonly photographed: PhotographedViews | undefined
  readonly #device: GPUDevice
  readonly #frames: Frames
  readonly #listener: EngineListener
  readonly #model: SceneModel
  readonly #whole: Promise<void>
  readonly #painter: Painter
  /** The current light, and the light that replaces it when it has arrived. */
  #shown: Lighting | undefined
  #coming: Lighting | undefined
  /** Key of the light whose last request failed. The viewer does not request it again with every picture. */
  #refused = ''
  #wish: { look: Look; view: OrbitView } | undefined
  #frame = 0
  #ready = false
  #closed = false

  private constructor(
    parts: { canvas: HTMLCanvasElement; device: GPUDevice; model: SceneModel; whole: Promise<void>; painter: Painter },
    frames: Frames,
    listener: EngineListener,
  ) {
    this.node = parts.canvas
    this.#device = parts.device
    this.#model = parts.model
    this.#whole = parts.whole
    this.#painter = parts.painter
    this.#frames = frames
    this.#listener = listener
    this.photographed = parts.model.header.photographed_views
    this.begin = this.photographed ? firstView(this.photographed) : framed(parts.model.header)
    const lost = () => {
      if (!this.#closed) listener.lost()
    }
    void this.#device.lost.then(lost)
    this.#whole.catch(lost)
  }

  /** Opens a device and begins to load the model; undefined if this browser cannot draw it. */
  static async open(frames: Frames, listener: EngineListener): Promise<LiveView | undefined> {
    const device = await openDevice()
    if (!device) return undefined
    try {
      const canvas = document.createElement('canvas')
      const context = canvas.getContext('webgpu')
      if (!context) throw new Error('no canvas for WebGPU')
      const format = navigator.gpu.getPreferredCanvasFormat()
      context.configure({ device, format, alphaMode: 'premultiplied' })
      let view: LiveView | undefined
      let begun = () => {}
      const beginning = new Promise<void>((resolve) => (begun = resolve))
      const model = new SceneModel(device, () => {
        begun()
        view?.invalidate()
      })
      const whole = frames.stream().then((answer) => readStream<ModelHeader>(answer, 'RLMG', model, listener.loaded))
      // The view handles later errors of `whole`; this prevents an unhandled rejection.
      whole.catch(() => {})
      await Promise.race([beginning, whole])
      const pipelines = await makePipelines(device, format, model.coefficients)
      const painter = new Painter(device, context, pipelines, model)
      view = new LiveView({ canvas, device, model, whole, painter }, frames, listener)
      return view
    } catch (error) {
      device.destroy()
      if (error instanceof DOMException && error.name === 'AbortError') throw error
      return undefined
    }
  }

  draw(look: Look, view: OrbitView): void {
    this.#wish = { look, view }
    this.#lit(look)
    this.invalidate()
  }

  pick(view: OrbitView, x: number, y: number): [number, number, number] | undefined {
    const { world_scale, world_offset } = this.#model.header
    const camera = cameraOf(view, this.#listener.size(), world_scale, world_offset)
    const found = frontPoint(camera, this.#model.means, this.#model.count, x, y)
    return found && [found[0] / world_scale - world_offset[0], found[1] / world_scale - world_offset[1], found[2] / world_scale - world_offset[2]]
  }

  async snapshot(look: Look, view: OrbitView): Promise<Blob> {
    this.draw(look, view)
    await Promise.all([this.#whole, this.#coming?.whole])
    if (this.#shown?.key !== keyOf(look) || !this.#paint()) throw new Error('the light is not there')
    // Call `toBlob` in the same task, because the canvas loses its picture afterwards.
    return new Promise((resolve, reject) => {
      this.node.toBlob((blob) => (blob ? resolve(blob) : reject(new Error('the canvas gave no picture'))), 'image/png')
    })
  }

  close(): void {
    this.#closed = true
    cancelAnimationFrame(this.#frame)
    this.#coming?.abort.abort()
    this.#shown?.abort.abort()
    this.#device.destroy()
  }

  /** Schedules a picture for the next animation frame. */
  invalidate(): void {
    if (this.#closed) return
    this.#frame ||= requestAnimationFrame(() => {
      this.#frame = 0
      if (this.#paint()) this.#listener.shown()
    })
  }

  /** Requests the light of `look`. The current light stays until the new one has arrived. */
  #lit(look: Look): void {
    const key = keyOf(look)
    if ((this.#coming ?? this.#shown)?.key === key || this.#refused === key) return
    if (this.#shown?.key === key) return this.#keep()
    this.#refused = ''
    this.#coming?.abort.abort()
    const abort = new AbortController()
    const light = new SceneLight(this.#device, () => {
      // The first light is shown while it arrives.
      if (!this.#shown) this.#shown = lighting
      this.invalidate()
    })
    const loaded = this.#frames
      .light(look, showsLight(look), abort.signal)
      .then((answer) => readStream<LightHeader>(answer, 'RLML', light))
    const lighting: Lighting = { key, light, abort, whole: loaded.then(() => this.#arrived(lighting)) }
    this.#coming = lighting
    if (this.#shown) this.#listener.waiting(true)
    lighting.whole.catch((error: unknown) => {
      if (this.#coming === lighting) {
        this.#coming = undefined
        this.#listener.waiting(false)
      }
      if (this.#shown === lighting) this.#shown = undefined
      light.destroy()
      if (abort.signal.aborted || this.#closed) return
      this.#refused = key
      this.#listener.failed(error)
    })
  }

  /** Cancels the light that is coming, because the shown one was chosen again. */
  #keep(): void {
    this.#coming?.abort.abort()
    this.#coming = undefined
    this.#listener.waiting(false)
  }

  async #arrived(lighting: Lighting): Promise<void> {
    if (this.#coming !== lighting) return
    this.#coming = undefined
    this.#listener.waiting(false)
    const before = this.#shown
    this.#shown = lighting
    if (before && before !== lighting) before.light.destroy()
    this.invalidate()
    await this.#whole
    if (!this.#ready && !this.#closed) {
      this.#ready = true
      this.#listener.ready()
    }
  }

  /** Draws now; returns false if there is nothing to draw yet. */
  #paint(): boolean {
    if (this.#closed || !this.#wish || !this.#shown) return false
    const { look, view } = this.#wish
    const [width, height] = this.#pixels()
    if (this.node.width !== width) this.node.width = width
    if (this.node.height !== height) this.node.height = height
    const { world_scale, world_offset } = this.#model.header
    this.#painter.paint(cameraOf(view, [width, height], world_scale, world_offset), this.#shown.light, finishOf(look))
    return true
  }

  #pixels(): [number, number] {
    const most = this.#device.limits.maxTextureDimension2D
    const [width, height] = this.#listener.size()
    const scale = Math.min(window.devicePixelRatio || 1, most / Math.max(width, height, 1))
    const side = (size: number) => Math.max(1, Math.round(size * scale))
    return [side(width), side(height)]
  }
}

/** The initial view in the header of a stream without photographed directions. */
function framed({ framing: { eye, target, fov_deg } }: ModelHeader): Partial<OrbitView> {
  const [x, y, z] = [eye[0] - target[0], eye[1] - target[1], eye[2] - target[2]]
  return {
    target,
    zero: 0,
    azimuth: degrees(Math.atan2(y, x)),
    elevation: degrees(Math.atan2(z, Math.hypot(x, y))),
    distance: Math.hypot(x, y, z),
    fov: fov_deg,
  }
}

function showsLight({ background, output }: Look): boolean {
  return background === 'environment' && output === 'rgb'
}

/** The key of the light that the server prepares for a look. */
function keyOf(look: Look): string {
  return JSON.stringify([look.environment, look.rotation, showsLight(look)])
}

function finishOf(look: Look): Finish {
  const { output, exposure, background } = look
  const digits = /^#?([0-9a-f]{6})$/i.exec(background)?.[1]
  const channel = (k: number) => Number.parseInt(digits?.slice(2 * k, 2 * k + 2) ?? '0', 16) / 255
  return {
    output,
    exposure,
    background: digits ? [channel(0), channel(1), channel(2)] : undefined,
    showsLight: showsLight(look),
  }
}
