import type { Camera } from './camera'

/** Greatest distance of a centre from the position in the picture, pixels. */
const REACH = 8
/** Share of the centres there, nearest first, that is taken as the front. A single one may float before the surface. */
const FRONT = 0.2

/** The point of the ray through a pixel at the depth of the Gaussians in front; undefined if none has its centre near the ray. */
export function frontPoint(camera: Camera, means: Float32Array, count: number, x: number, y: number): [number, number, number] | undefined {
  const { width, height, focal, rotation: [right, down, forward], translation: [tx, ty, tz], centre } = camera
  const depths: number[] = []
  for (let i = 0; i < count; i++) {
    const [a, b, c] = [means[3 * i]!, means[3 * i + 1]!, means[3 * i + 2]!]
    const depth = forward[0] * a + forward[1] * b + forward[2] * c + tz
    if (depth <= 0) continue
    const u = width / 2 + (focal * (right[0] * a + right[1] * b + right[2] * c + tx)) / depth
    const v = height / 2 + (focal * (down[0] * a + down[1] * b + down[2] * c + ty)) / depth
    if (Math.hypot(u - x, v - y) < REACH) depths.push(depth)
  }
  if (!depths.length) return undefined
  const depth = depths.sort((a, b) => a - b)[Math.floor(FRONT * depths.length)]!
  const [u, v] = [(x - width / 2) / focal, (y - height / 2) / focal]
  const along = (k: 0 | 1 | 2) => centre[k] + depth * (u * right[k] + v * down[k] + forward[k])
  return [along(0), along(1), along(2)]
}
