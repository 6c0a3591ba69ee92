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

/** Degrees per key press. */
const STEP = 5
/** Degrees per pixel of a drag. */
const DRAG = 0.4

/** Controls an orbit with pointer, wheel and keyboard events of an element. */
export class Orbit {
  readonly #element: HTMLElement
  readonly #changed: () => void
  #view: OrbitView = { azimuth: 0, zero: 0, elevation: 20, distance: 4, target: [0, 0, 0], fov: 40 }
  #listening: AbortController | undefined
  readonly #pointers = new Map<number, PointerEvent>()

  constructor(element: HTMLElement, changed: () => void) {
    this.#element = element
    this.#changed = changed
  }

  view(): OrbitView {
    return { ...this.#view, target: [...this.#view.target] }
  }

  set(view: Partial<OrbitView>): void {
    Object.assign(this.#view, view)
    this.#view.elevation = Math.min(89, Math.max(-89, this.#view.elevation))
  }

  /** Sets the target and the distance so that the whole ball is visible. */
  frame({ centre, radius }: { centre: [number, number, number]; radius: number }): void {
    const distance = (1.1 * radius) / Math.sin((this.#view.fov * Math.PI) / 360)
    this.set({ target: centre, distance })
  }

  turn(azimuth: number, elevation = 0): void {
    this.set({ azimuth: (this.#view.azimuth + azimuth + 360) % 360, elevation: this.#view.elevation + elevation })
    this.#changed()
  }

  approach(factor: number): void {
    this.set({ distance: Math.max(1e-3, this.#view.distance * factor) })
    this.#changed()
  }

  listen(): void {
    this.#listening = new AbortController()
    const { signal } = this.#listening
    const on = <K extends keyof HTMLElementEventMap>(name: K, handler: (event: HTMLElementEventMap[K]) => void) =>
      this.#element.addEventListener(name, handler, { signal, passive: false })
    on('pointerdown', (event) => {
      this.#element.setPointerCapture(event.pointerId)
      this.#pointers.set(event.pointerId, event)
    })
    on('pointermove', (event) => this.#drag(event))
    const end = (event: PointerEvent) => void this.#pointers.delete(event.pointerId)
    on('pointerup', end)
    on('pointercancel', end)
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
    const others = [...this.#pointers.values()].filter((other) => other.pointerId !== event.pointerId)
    const other = others[0]
    this.#pointers.set(event.pointerId, event)
    if (other) {
      const from = (point: PointerEvent) => Math.hypot(point.clientX - other.clientX, point.clientY - other.clientY)
      this.approach(from(before) / Math.max(1, from(event)))
    } else {
      this.turn(-(event.clientX - before.clientX) * DRAG, (event.clientY - before.clientY) * DRAG)
    }
  }

  #key(event: KeyboardEvent): void {
    const moves: Record<string, () => void> = {
      ArrowLeft: () => this.turn(-STEP),
      ArrowRight: () => this.turn(STEP),
      ArrowUp: () => this.turn(0, STEP),
      ArrowDown: () => this.turn(0, -STEP),
      '+': () => this.approach(0.9),
      '=': () => this.approach(0.9),
      '-': () => this.approach(1 / 0.9),
    }
    const move = moves[event.key]
    if (!move || event.ctrlKey || event.metaKey || event.altKey) return
    event.preventDefault()
    move()
  }
}
