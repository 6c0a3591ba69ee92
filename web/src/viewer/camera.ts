import { eye, type OrbitView } from './orbit'

type Triple = [number, number, number]

/** A pinhole camera in the world space of a model: OpenCV axes, world to camera `R x + t`. */
export interface Camera {
  width: number
  height: number
  /** Focal length in x and y, pixels. */
  focal: number
  /** Rows of R. */
  rotation: [Triple, Triple, Triple]
  translation: Triple
  centre: Triple
}

const minus = (a: Triple, b: Triple): Triple => [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
const dot = (a: Triple, b: Triple): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
const cross = (a: Triple, b: Triple): Triple => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
]

function unit(v: Triple): Triple {
  const length = Math.hypot(...v)
  return [v[0] / length, v[1] / length, v[2] / length]
}

/** Converts a view in capture units to a camera in the model's world space, `scale * (x + offset)`. +Z is up in both. */
export function cameraOf(view: OrbitView, [width, height]: [number, number], scale: number, offset: Triple): Camera {
  const from = eye(view)
  const forward = unit(minus(view.target, from))
  const right = unit(cross(forward, [0, 0, 1]))
  const rotation: Camera['rotation'] = [right, cross(forward, right), forward]
  const centre: Triple = [scale * (from[0] + offset[0]), scale * (from[1] + offset[1]), scale * (from[2] + offset[2])]
  return {
    width,
    height,
    focal: (0.5 * height) / Math.tan((view.fov * Math.PI) / 360),
    rotation,
    translation: [-dot(rotation[0], centre), -dot(rotation[1], centre), -dot(rotation[2], centre)],
    centre,
  }
}
