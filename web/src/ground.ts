import type { Lamp, RenderRequest } from './api/types'

/** Eight-bit pixels, row by row: red, green, blue, alpha. */
export interface Pixels {
  width: number
  height: number
  data: Uint8ClampedArray
}

/** The two factors of the ground that the page requests. */
export type GroundOutput = 'shadow' | 'bounce'

/** The pictures of a ground: its factors, and the light of lamps on it as an output of {@link lampLightRequest}. */
export interface GroundPictures {
  shadow: Pixels
  bounce: Pixels
  lampLight?: Pixels | undefined
}

/** Radiance of a white ground under the lamps at which the picture of their light is white. Brighter ground is clipped. */
const LAMP_RANGE = 4
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

/** The request for the light of `lamps` on the ground by the camera of a picture, as a share of {@link LAMP_RANGE}. */
export function lampLightRequest({ camera, width, height, materials }: RenderRequest, lamps: Lamp[], at: number | undefined): RenderRequest {
  return {
    camera,
    width,
    height,
    ...(materials ? { materials } : {}),
    lamps: lamps.map((lamp) => ({ ...lamp, intensity: (lamp.intensity ?? 0) / LAMP_RANGE })),
    outputs: ['lamp_light'],
    ...(at === undefined ? {} : { ground_height: at }),
  }
}

/**
 * A picture over a ground of one colour, `#rrggbb`: `ground = floor * (shadow + bounce + lamp light)` and
 * `result = rgb + ground * (1 - alpha)` in linear light. Without the model and lamps the ground has the colour `floor` under every
 * environment. The picture has straight alpha, and all pictures have the sRGB curve.
 */
export function onGround(picture: Pixels, { shadow, bounce, lampLight }: GroundPictures, floor: string): Pixels {
  const { width, height } = picture
  if ([shadow, bounce, lampLight].some((one) => one && one.data.length !== picture.data.length)) throw new Error('The pictures differ in size.')
  const colour = [1, 3, 5].map((at) => linear(parseInt(floor.slice(at, at + 2), 16)))
  const data = new Uint8ClampedArray(picture.data.length)
  for (let i = 0; i < data.length; i += 4) {
    const alpha = (picture.data[i + 3] ?? 0) / 255
    for (let c = 0; c < 3; c++) {
      const lit = lampLight ? LAMP_RANGE * linear(lampLight.data[i + c]) : 0
      const ground = (colour[c] ?? 0) * (linear(shadow.data[i + c]) + linear(bounce.data[i + c]) + lit)
      data[i + c] = shown(linear(picture.data[i + c]) * alpha + ground * (1 - alpha))
    }
    data[i + 3] = 255
  }
  return { width, height, data }
}
