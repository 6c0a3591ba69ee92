import type { Point } from './lamps'

/** The camera of a render request that looks at a point. */
export interface LookAt {
  eye: number[]
  target: number[]
  /** Vertical field of view, degrees. */
  fov_y_deg: number
}

/** A place in a picture: shares of its width and height from the upper left, 0 to 1, and the depth along the axis of the camera, capture units. */
export interface Seen {
  at: [number, number]
  depth: number
}

const minus = (a: number[], b: number[]): Point => [a[0]! - b[0]!, a[1]! - b[1]!, a[2]! - b[2]!]
const dot = (a: Point, b: Point): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
const cross = (a: Point, b: Point): Point => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
const unit = (a: Point): Point => {
  const length = Math.hypot(...a)
  return [a[0] / length, a[1] / length, a[2] / length]
}

/** Right, down and forward of a camera; +Z is up. */
function axes({ eye, target }: LookAt): [Point, Point, Point] {
  const forward = unit(minus(target, eye))
  const right = unit(cross(forward, [0, 0, 1]))
  return [right, cross(forward, right), forward]
}

/** Half the width and half the height of the picture at depth 1. */
function halves({ fov_y_deg }: LookAt, aspect: number): [number, number] {
  const high = Math.tan((fov_y_deg * Math.PI) / 360)
  return [aspect * high, high]
}

/** Where a point is in a picture with this ratio of width and height. Undefined behind the camera. */
export function projected(camera: LookAt, aspect: number, point: number[]): Seen | undefined {
  const [right, down, forward] = axes(camera)
  const [wide, high] = halves(camera, aspect)
  const from = minus(point, camera.eye)
  const depth = dot(from, forward)
  if (depth <= 0) return undefined
  return { at: [0.5 + dot(from, right) / (2 * wide * depth), 0.5 + dot(from, down) / (2 * high * depth)], depth }
}

/** The point that is seen at a place of a picture. */
export function unprojected(camera: LookAt, aspect: number, { at, depth }: Seen): Point {
  const [right, down, forward] = axes(camera)
  const [wide, high] = halves(camera, aspect)
  const [x, y] = [(2 * at[0] - 1) * wide * depth, (2 * at[1] - 1) * high * depth]
  const along = (k: 0 | 1 | 2) => camera.eye[k]! + x * right[k] + y * down[k] + depth * forward[k]
  return [along(0), along(1), along(2)]
}

/** The least distance from which a camera with this direction and target has points in its picture, at most at this share of half its sides. Capture units. */
export function distanceOf(camera: LookAt, aspect: number, points: number[][], share: number): number {
  const [right, down, forward] = axes(camera)
  const [wide, high] = halves(camera, aspect)
  const needed = points.map((point) => {
    const from = minus(point, camera.target)
    return Math.max(Math.abs(dot(from, right)) / (share * wide), Math.abs(dot(from, down)) / (share * high)) - dot(from, forward)
  })
  return Math.max(0, ...needed)
}

/** Depths of a picture of a model, row by row: levels from 0 at `near` to 255 at `far`. */
export interface Depths {
  width: number
  height: number
  levels: Uint8Array
  near: number
  far: number
}

/** The level of pixels without a surface. */
const EMPTY = 255

/** The depth of the surface at a place of the picture, capture units. Undefined where there is none. */
export function depthAt({ width, height, levels, near, far }: Depths, [x, y]: [number, number]): number | undefined {
  const inside = (share: number, side: number) => Math.min(side - 1, Math.max(0, Math.floor(share * side)))
  const level = levels[inside(y, height) * width + inside(x, width)] ?? EMPTY
  return level === EMPTY ? undefined : near + ((far - near) * level) / EMPTY
}
