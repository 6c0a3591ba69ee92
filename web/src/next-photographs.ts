import type { NextPhotograph, NextPhotographs } from './api/types'

/** Number of places that the page asks for. */
export const PLACES = 10
/** Angle between a view and a place below which the view is at the place, degrees. Views end at an elevation of 89. */
const AT = 2

const radians = (degrees: number): number => (degrees * Math.PI) / 180

/** The direction of a place from the subject, in words. The azimuth of the API is counter-clockwise seen from above: to the right for someone at the first photograph who looks at the subject. */
export function spokenDirection({ azimuth_deg, elevation_deg }: Pick<NextPhotograph, 'azimuth_deg' | 'elevation_deg'>): string {
  const turn = ((Math.round(azimuth_deg) % 360) + 360) % 360
  const up = Math.round(elevation_deg)
  const height = up === 0 ? 'level' : `${Math.abs(up)}° ${up > 0 ? 'up' : 'down'}`
  if (Math.abs(up) === 90) return up > 0 ? 'from straight above' : 'from straight below'
  if (turn === 0) return `on the side of the first photograph, ${height}`
  if (turn === 180) return `opposite the first photograph, ${height}`
  return `${turn < 180 ? turn : 360 - turn}° to the ${turn < 180 ? 'right' : 'left'} of the first photograph, ${height}`
}

/** The position of the camera of a place, capture units. */
export function positionOf({ camera }: Pick<NextPhotograph, 'camera'>): number[] | undefined {
  const rows = camera.camera_to_world
  return rows ? [0, 1, 2].map((row) => rows[row]?.[3] ?? 0) : undefined
}

/** Whether a view has the direction of a place. */
export function isAt({ azimuth_deg, elevation_deg }: Pick<NextPhotograph, 'azimuth_deg' | 'elevation_deg'>, view: { azimuth: number; elevation: number }): boolean {
  const [here, there] = [radians(view.elevation), radians(elevation_deg)]
  const cosine = Math.sin(here) * Math.sin(there) + Math.cos(here) * Math.cos(there) * Math.cos(radians(view.azimuth - azimuth_deg))
  return cosine > Math.cos(radians(AT))
}

/** The path of the picture of a model from a place. */
export function thumbnailOf(model: string, { azimuth_deg, elevation_deg }: Pick<NextPhotograph, 'azimuth_deg' | 'elevation_deg'>): string {
  // The sum makes 0 of -0.
  const round = (degrees: number) => Number(degrees.toFixed(1)) + 0
  return `v1/models/${encodeURIComponent(model)}/thumbnail?azimuth=${round(azimuth_deg)}&elevation=${round(elevation_deg)}&size=96`
}

/** The places as a file: a camera path for exports of frames and for the option `--path` of `relume render`. */
export function placesFile(places: NextPhotographs): string {
  return `${JSON.stringify(places, null, 2)}\n`
}
