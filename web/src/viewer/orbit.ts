/** A camera that orbits a point. Angles are in degrees and lengths in capture units; +Z is up. */
export interface OrbitView {
  /** Degrees counter-clockwise seen from above, from `zero`. */
  azimuth: number
  /** The azimuth of the first photograph, degrees from the +x side; 0 if the model does not record it. */
  zero: number
  /** Degrees above the horizon, -89 to 89. */
  elevation: number
  /** Distance from the target. */
  distance: number
  /** The point at which the camera looks. */
  target: [number, number, number]
  /** Vertical field of view. */
  fov: number
}

export const radians = (degrees: number): number => (degrees * Math.PI) / 180
export const degrees = (radians: number): number => (radians * 180) / Math.PI

/** The unit vector with this azimuth and elevation, degrees. */
export function direction(azimuth: number, elevation: number): [number, number, number] {
  const [a, e] = [radians(azimuth), radians(elevation)]
  return [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)]
}

/** The position of an orbiting camera. */
export function eye({ azimuth, zero, elevation, distance, target }: OrbitView): [number, number, number] {
  const [x, y, z] = direction(zero + azimuth, elevation)
  return [target[0] + distance * x, target[1] + distance * y, target[2] + distance * z]
}

/** A view that frames a subject in a square, from farther away if the picture is narrower than high. */
export function fitted(view: Partial<OrbitView>, aspect: number): Partial<OrbitView> {
  const { distance, fov } = view
  if (distance === undefined || fov === undefined || aspect >= 1 || aspect <= 0) return view
  const half = radians(fov) / 2
  return { ...view, distance: (distance * Math.sin(half)) / Math.sin(Math.atan(Math.tan(half) * aspect)) }
}

/** Moves the target of a view by fractions of the picture's height, to the right and up in the picture. */
export function panned(view: OrbitView, right: number, up: number): [number, number, number] {
  const [azimuth, elevation] = [radians(view.zero + view.azimuth), radians(view.elevation)]
  const height = 2 * view.distance * Math.tan(radians(view.fov) / 2)
  const side = [-Math.sin(azimuth), Math.cos(azimuth), 0]
  const above = [-Math.sin(elevation) * Math.cos(azimuth), -Math.sin(elevation) * Math.sin(azimuth), Math.cos(elevation)]
  const along = (k: number) => view.target[k]! + height * (right * side[k]! + up * above[k]!)
  return [along(0), along(1), along(2)]
}

/** Degrees per key press. */
const STEP = 5
/** Fraction of the picture's height per key press with Shift. */
const PAN_STEP = 0.05
/** Degrees per pixel of a drag. */
const DRAG = 0.4
/** Factor of the distance when the camera focuses on a point. */
const FOCUS = 0.6

/** What an orbit tells its element. */
export interface OrbitListener {
  /** The user moved the camera. */
  changed(): void
  /** The initial view for the current size of the picture. */
  initial(): Partial<OrbitView>
  /** The user asks for the point of the model at a position of the picture, pixels from its upper left corner. */
  pick(x: number, y: number): [number, number, number] | undefined
}

/** Controls an orbit with pointer, wheel and keyboard events of an element. */
export class Orbit {
  readonly #element: HTMLElement
  readonly #listener: OrbitListener
  #view: OrbitView = { azimuth: 0, zero: 0, elevation: 20, distance: 4, target: [0, 0, 0], fov: 40 }
  /** The view when the last pointer went down. */
  #held: Partial<OrbitView> = {}
  #listening: AbortController | undefined
  readonly #pointers = new Map<number, PointerEvent>()

  constructor(element: HTMLElement, listener: OrbitListener) {
    this.#element = element
    this.#listener = listener
  }

  view(): OrbitView {
    return { ...this.#view, target: [...this.#view.target] }
  }

  set(view: Partial<OrbitView>): void {
    Object.assign(this.#view, view)
    this.#view.elevation = Math.min(89, Math.max(-89, this.#view.elevation))
  }

  /** Returns to the initial view. */
  reset(): void {
    this.set(this.#listener.initial())
    this.#listener.changed()
  }

  turn(azimuth: number, elevation = 0): void {
    this.set({ azimuth: (this.#view.azimuth + azimuth + 360) % 360, elevation: this.#view.elevation + elevation })
    this.#listener.changed()
  }

  approach(factor: number): void {
    this.set({ distance: Math.max(1e-3, this.#view.distance * factor) })
    this.#listener.changed()
  }

  /** Moves the picture by fractions of its height. */
  pan(right: number, up: number): void {
    this.set({ target: panned(this.#view, -right, -up) })
    this.#listener.changed()
  }

  listen(): void {
    this.#listening = new AbortController()
    const { signal } = this.#listening
    const on = <K extends keyof HTMLElementEventMap>(name: K, handler: (event: HTMLElementEventMap[K]) => void) =>
      this.#element.addEventListener(name, handler, { signal, passive: false })
    on('pointerdown', (event) => {
      this.#held = this.view()
      this.#element.setPointerCapture(event.pointerId)
      this.#pointers.set(event.pointerId, event)
    })
    on('pointermove', (event) => this.#drag(event))
    const end = (event: PointerEvent) => void this.#pointers.delete(event.pointerId)
    on('pointerup', end)
    on('pointercancel', (event) => {
      end(event)
      // The browser takes the finger to scroll the page, so its first pixels were no drag.
      this.set(this.#held)
      this.#listener.changed()
    })
    // One finger may scroll the page up and down; two fingers move the model.
    on('touchstart', (event) => event.touches.length > 1 && event.preventDefault())
    on('touchmove', (event) => event.touches.length > 1 && event.cancelable && event.preventDefault())
    on('dblclick', (event) => this.#focus(event))
    on('wheel', (event) => {
      event.preventDefault()
      this.approach(Math.exp(event.deltaY * 0.001))
    })
    on('keydown', (event) => this.#key(event))
  }

  unlisten(): void {
    this.#listening?.abort()
    this.#pointers.clear()
  }

  #drag(event: PointerEvent): void {
    const before = this.#pointers.get(event.pointerId)
    if (!before) return
    const other = [...this.#pointers.values()].find(({ pointerId }) => pointerId !== event.pointerId)
    this.#pointers.set(event.pointerId, event)
    const [x, y] = [event.clientX - before.clientX, event.clientY - before.clientY]
    const height = Math.max(1, this.#element.clientHeight)
    if (other) {
      const from = (point: PointerEvent) => Math.hypot(point.clientX - other.clientX, point.clientY - other.clientY)
      // Each of the two fingers moves their middle by half.
      this.set({ target: panned(this.#view, -x / 2 / height, y / 2 / height) })
      this.approach(from(before) / Math.max(1, from(event)))
    } else if (event.shiftKey) {
      this.pan(x / height, -y / height)
    } else {
      this.turn(-x * DRAG, y * DRAG)
    }
  }

  #focus(event: MouseEvent): void {
    const box = this.#element.getBoundingClientRect()
    const [x, y] = [event.clientX - box.left, event.clientY - box.top]
    const height = Math.max(1, box.height)
    // Without a point of the model there: the point of the plane through the target.
    const plane = () => panned(this.#view, (x - box.width / 2) / height, (box.height / 2 - y) / height)
    this.set({ target: this.#listener.pick(x, y) ?? plane(), distance: this.#view.distance * FOCUS })
    this.#listener.changed()
  }

  #key(event: KeyboardEvent): void {
    const shifted: Record<string, () => void> = {
      ArrowLeft: () => this.pan(-PAN_STEP, 0),
      ArrowRight: () => this.pan(PAN_STEP, 0),
      ArrowUp: () => this.pan(0, PAN_STEP),
      ArrowDown: () => this.pan(0, -PAN_STEP),
    }
    const moves: Record<string, () => void> = {
      ArrowLeft: () => this.turn(-STEP),
      ArrowRight: () => this.turn(STEP),
      ArrowUp: () => this.turn(0, STEP),
      ArrowDown: () => this.turn(0, -STEP),
      '+': () => this.approach(0.9),
      '=': () => this.approach(0.9),
      '-': () => this.approach(1 / 0.9),
      Home: () => this.reset(),
    }
    const move = (event.shiftKey ? shifted[event.key] : undefined) ?? moves[event.key]
    if (!move || event.ctrlKey || event.metaKey || event.altKey) return
    event.preventDefault()
    move()
  }
}
