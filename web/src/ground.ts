import type { RenderRequest } from './api/types'

/** Eight-bit pixels, row by row: red, green, blue, alpha. */
export interface Pixels {
  width: number
  height: number
  data: Uint8ClampedArray
}

/** The two factors of the ground that the page requests. */
export type GroundOutput = 'shadow' | 'bounce'

/** Levels of the table of the inverse sRGB curve. */
const LEVELS = 4096

/** The linear value of each level of the sRGB curve. */
const LINEAR = Float32Array.from({ length: 256 }, (_, level) => {
  const value = level / 255
  return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4
})

/** The levels of the sRGB curve of linear values from 0 to 1. */
const CURVE = Uint8ClampedArray.from({ length: LEVELS }, (_, i) => {
  const value = i / (LEVELS - 1)
  return 255 * (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055)
})

const linear = (level: number | undefined): number => LINEAR[level ?? 0] ?? 0
const shown = (value: number): number => CURVE[Math.round(Math.min(1, value) * (LEVELS - 1))] ?? 0

/**
 * The request for a factor of the ground by the camera of a picture. The factors do not depend on the lamps and on the exposure of
 * the light, so other lamps need no new ones.
 */
export function groundRequest({ camera, width, height, environment, materials }: RenderRequest, output: GroundOutput, at: number | undefined): RenderRequest {
  return {
    camera,
    width,
    height,
    ...(environment ? { environment: { ...environment, exposure_ev: 0 } } : {}),
    ...(materials ? { materials } : {}),
    outputs: [output],
    ...(at === undefined ? {} : { ground_height: at }),
  }
}

/**
 * A picture over a ground of one colour, `#rrggbb`: `ground = floor * (shadow + bounce)` and `result = rgb + ground * (1 - alpha)` in
 * linear light. The picture has straight alpha, and all three have the sRGB curve.
 */
export function onGround(picture: Pixels, shadow: Pixels, bounce: Pixels, floor: string): Pixels {
  const { width, height } = picture
  if (shadow.data.length !== picture.data.length || bounce.data.length !== picture.data.length) throw new Error('The pictures differ in size.')
  const colour = [1, 3, 5].map((at) => linear(parseInt(floor.slice(at, at + 2), 16)))
  const data = new Uint8ClampedArray(picture.data.length)
  for (let i = 0; i < data.length; i += 4) {
    const alpha = (picture.data[i + 3] ?? 0) / 255
    for (let c = 0; c < 3; c++) {
      const ground = (colour[c] ?? 0) * (linear(shadow.data[i + c]) + linear(bounce.data[i + c]))
      data[i + c] = shown(linear(picture.data[i + c]) * alpha + ground * (1 - alpha))
    }
    data[i + 3] = 255
  }
  return { width, height, data }
}
