import { degrees, direction, radians, type OrbitView } from './orbit'

/** The directions from which a model was photographed: `photographed_views` of its card. Capture units, degrees. */
export interface PhotographedViews {
  target: [number, number, number]
  radius: number
  distance: number
  /** Azimuth of the first photograph from +x. */
  azimuth_deg: number
  elevation_deg: number
  fov_deg: number
  photographs: { name: string; azimuth_deg: number; elevation_deg: number }[]
}

/** Angle from the nearest photograph above which a view shows parts that may not have been photographed, degrees. */
const UNSEEN = 20
/** Margin of the default view around the subject, and its least field of view relative to the photographs (crates/scene/src/photographed_views.rs). */
const MARGIN = 1.1
const LEAST_FOV = 0.1

/** The record of a model card if it defines a view, by the rule of the server. */
export function recorded(card: unknown): PhotographedViews | undefined {
  const views = (card as { photographed_views?: PhotographedViews | null } | null)?.photographed_views
  if (!views || !Array.isArray(views.target) || !Array.isArray(views.photographs)) return undefined
  const isDirection = (azimuth: number, elevation: number) => Number.isFinite(azimuth) && Math.abs(elevation) <= 90
  const isPlaced = views.target.length === 3 && views.target.every(Number.isFinite) && views.radius > 0 && views.distance > 0
  const isSeen = views.fov_deg > 0 && views.fov_deg < 180 && isDirection(views.azimuth_deg, views.elevation_deg)
  const isPhotograph = (p: PhotographedViews['photographs'][number] | null) =>
    typeof p?.name === 'string' && isDirection(p.azimuth_deg, p.elevation_deg)
  return isPlaced && isSeen && views.photographs.length > 0 && views.photographs.every(isPhotograph) ? views : undefined
}

/** The default view: that of the first photograph at the median elevation, with the subject in the frame. */
export function firstView(views: PhotographedViews): Partial<OrbitView> {
  const { target, radius, distance, fov_deg } = views
  const half = radians(fov_deg) / 2
  const framed = MARGIN * radius
  const fits = framed < distance * Math.sin(half)
  return {
    target,
    zero: views.azimuth_deg,
    azimuth: 0,
    elevation: views.elevation_deg,
    distance: fits ? distance : framed / Math.sin(half),
    fov: fits ? 2 * degrees(Math.max(Math.asin(framed / distance), LEAST_FOV * half)) : fov_deg,
  }
}

/** The photograph whose direction is nearest to that of a view, and the angle between them in degrees. */
export function nearest({ photographs }: PhotographedViews, view: OrbitView): { angle: number; name: string } {
  const to = direction(view.zero + view.azimuth, view.elevation)
  let best = { cosine: -Infinity, name: '' }
  for (const { name, azimuth_deg, elevation_deg } of photographs) {
    const from = direction(azimuth_deg, elevation_deg)
    const cosine = from[0] * to[0] + from[1] * to[1] + from[2] * to[2]
    if (cosine > best.cosine) best = { cosine, name }
  }
  return { angle: degrees(Math.acos(Math.min(1, best.cosine))), name: best.name }
}

/** A map of the sphere of directions: straight up in the middle, the horizon half way, the first photograph at the bottom. */
export class PhotographedMap {
  readonly node = document.createElement('figure')
  readonly views: PhotographedViews
  readonly #camera = shape('circle', { r: '7', class: 'camera' })
  readonly #text = document.createElement('figcaption')

  constructor(views: PhotographedViews) {
    this.views = views
    this.node.className = 'photographed'
    const svg = shape('svg', { viewBox: '-102 -102 204 204', 'aria-hidden': 'true' })
    const seen = shape('g', { class: 'seen' })
    for (const { azimuth_deg, elevation_deg } of views.photographs) {
      seen.append(shape('circle', { r: String((100 * UNSEEN) / 180), ...this.#at(azimuth_deg, elevation_deg) }))
    }
    svg.append(shape('circle', { r: '100', class: 'sphere' }), seen, shape('circle', { r: '50', class: 'horizon' }), this.#camera)
    this.node.append(svg, this.#text)
  }

  /** Moves the marker to a view and states its angle to the nearest photograph. */
  show(view: OrbitView): void {
    for (const [name, value] of Object.entries(this.#at(view.zero + view.azimuth, view.elevation))) this.#camera.setAttribute(name, value)
    const { angle, name } = nearest(this.views, view)
    const file = name.replace(/^.*\//, '')
    this.#text.textContent = `${angle.toFixed(0)}° from ${file}${angle > UNSEEN ? ': a guess' : ''}`
    this.node.classList.toggle('guess', angle > UNSEEN)
  }

  #at(azimuth: number, elevation: number): { cx: string; cy: string } {
    const [turn, away] = [radians(azimuth - this.views.azimuth_deg - 90), (100 * (90 - elevation)) / 180]
    return { cx: (away * Math.cos(turn)).toFixed(1), cy: (-away * Math.sin(turn)).toFixed(1) }
  }
}

function shape(name: string, attributes: Record<string, string>): SVGElement {
  const made = document.createElementNS('http://www.w3.org/2000/svg', name)
  for (const [attribute, value] of Object.entries(attributes)) made.setAttribute(attribute, value)
  return made
}
