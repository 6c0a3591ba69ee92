import type { components } from '../api/schema'
import { eye, type OrbitView } from './orbit'
import { recorded, type PhotographedViews } from './photographed'

type RenderRequest = components['schemas']['RenderRequest']

/** All settings of a frame except the camera. */
export interface Look {
  environment: string
  /** Degrees. */
  rotation: number
  /** Stops. */
  exposure: number
  background: string
  output: string
}

/** Outputs whose names differ in the API. */
const OUTPUTS: Record<string, string> = { metalness: 'metallic', ao: 'visibility' }

/** Sides of a thumbnail, pixels. */
const SMALLEST_THUMBNAIL = 16
const LARGEST_THUMBNAIL = 1024

const BUILTIN = ['recovered', 'studio', 'sunset', 'overcast', 'dawn', 'night', 'white']

/** The body of a request for a frame. */
export function renderRequest(look: Look, view: OrbitView, [width, height]: [number, number], fast = false): RenderRequest {
  const light = BUILTIN.includes(look.environment) ? { builtin: look.environment } : { id: look.environment }
  return {
    camera: { look_at: { eye: eye(view), target: view.target, up: [0, 0, 1], fov_y_deg: view.fov } },
    environment: { ...light, rotation_deg: look.rotation, exposure_ev: look.exposure },
    width,
    height,
    outputs: [OUTPUTS[look.output] ?? look.output],
    background: look.background,
    // The tier `preview` has only colour.
    tier: fast && look.output === 'rgb' ? 'preview' : 'standard',
  }
}

/** The requests for a model of a server. */
export class Frames {
  readonly #server: string
  readonly #model: string
  readonly #headers: Record<string, string>
  readonly #isShared: boolean
  readonly #closed = new AbortController()

  /** `server` must end with a slash. `share` is the query of the share page of the model. */
  constructor(server: string, model: string, { apiKey, share }: { apiKey?: string | undefined; share?: string | undefined } = {}) {
    this.#server = server
    this.#model = encodeURIComponent(model)
    this.#isShared = Boolean(share)
    this.#headers = share ? { 'Relume-Share': share } : apiKey ? { Authorization: `Bearer ${apiKey}` } : {}
  }

  close(): void {
    this.#closed.abort()
  }

  /** The photographed directions of the model, or its bounding sphere if it does not record them; capture units. */
  async framing(): Promise<PhotographedViews | { centre: [number, number, number]; radius: number }> {
    // The frames of a shared model are thumbnails, whose camera has its own centre and distance.
    if (this.#isShared) return { centre: [0, 0, 0], radius: 1 }
    const model = (await (await this.#ask(`models/${this.#model}`)).json()) as components['schemas']['ModelView']
    const views = recorded(model.card)
    if (views) return views
    try {
      const answer = await this.#ask(`captures/${encodeURIComponent(model.capture)}`)
      const { report } = (await answer.json()) as components['schemas']['CaptureView']
      const [x = 0, y = 0, z = 0] = report.centre
      return { centre: [x, y, z], radius: report.radius }
    } catch (error) {
      // The capture may have been deleted.
      if (error instanceof DOMException) throw error
      return { centre: [0, 0, 0], radius: 1.3 }
    }
  }

  /** The model stream (docs/viewer-stream.md). */
  stream(): Promise<Response> {
    return this.#ask(`models/${this.#model}/stream`)
  }

  /** The light stream for an environment. `map`: includes the environment map, to show it as the background. */
  light({ environment, rotation }: Look, map: boolean, signal: AbortSignal): Promise<Response> {
    const query = new URLSearchParams({ environment, rotation: String(rotation), map: String(map) })
    return this.#ask(`models/${this.#model}/light?${query}`, { signal })
  }

  /** A frame as a PNG. `fast` reduces detail to save time. */
  async frame(look: Look, view: OrbitView, size: [number, number], fast = false): Promise<Blob> {
    if (this.#isShared) return this.#thumbnail(look, view, size, fast)
    const body = JSON.stringify(renderRequest(look, view, size, fast))
    const headers = { 'Content-Type': 'application/json', Accept: 'image/png' }
    const answer = await this.#ask(`models/${this.#model}/render`, { method: 'POST', body, headers })
    return answer.blob()
  }

  /** A square picture in place of a frame, for a page that may read but not render. */
  async #thumbnail({ environment }: Look, view: OrbitView, [width, height]: [number, number], fast: boolean): Promise<Blob> {
    const side = Math.min(LARGEST_THUMBNAIL, Math.max(SMALLEST_THUMBNAIL, Math.min(width, height)))
    const query = new URLSearchParams({
      env: environment,
      size: String(side),
      azimuth: view.azimuth.toFixed(1),
      elevation: view.elevation.toFixed(1),
      tier: fast ? 'preview' : 'standard',
    })
    return (await this.#ask(`models/${this.#model}/thumbnail?${query}`)).blob()
  }

  async #ask(path: string, init: RequestInit = {}): Promise<Response> {
    const headers = { ...this.#headers, ...init.headers }
    const signal = init.signal ? AbortSignal.any([init.signal, this.#closed.signal]) : this.#closed.signal
    // A calibration changes the model; the server answers 304 while it has not changed.
    const answer = await fetch(`${this.#server}v1/${path}`, { cache: 'no-cache', ...init, headers, signal })
    if (answer.ok) return answer
    const problem = (await answer.json().catch(() => null)) as components['schemas']['Problem'] | null
    throw new Error(problem?.detail ?? problem?.title ?? `the server answered ${answer.status}`)
  }
}
