import type { Problem, RenderRequest } from './api/types'
import type { Pixels } from './ground'

type Colour = [number, number, number]

/** The colours of the confidences 0, 1/2 and 1, sRGB: readers with a colour vision deficiency can tell them apart. */
const SCALE: [Colour, Colour, Colour] = [[213, 72, 0], [247, 236, 190], [0, 98, 178]]
/** Opacity of the colours over the picture. */
const OPACITY = 0.8

/** The colour of a confidence from 0 to 1, interpolated in sRGB as the gradients of CSS are. */
export function colourOf(confidence: number): Colour {
  const at = 2 * Math.min(1, Math.max(0, confidence))
  const [from, to] = at < 1 ? [SCALE[0], SCALE[1]] : [SCALE[1], SCALE[2]]
  const share = at < 1 ? at : at - 1
  return [0, 1, 2].map((c) => Math.round(from[c]! + share * (to[c]! - from[c]!))) as Colour
}

/** The colour scale as a value of the CSS property `background`. */
export const GRADIENT = `linear-gradient(to right, ${SCALE.map((colour) => `rgb(${colour.join(' ')})`).join(', ')})`

/** The request for the confidence by the camera of a picture. The light and the materials do not change the confidence. */
export function confidenceRequest({ camera, width, height }: RenderRequest): RenderRequest {
  return { camera, width, height, outputs: ['confidence'] }
}

/** The colours of the confidence over the model of a picture. `grey` has the confidence in its red channel; it does not tell empty pixels from a confidence of 0, so `picture` gives the coverage. */
export function coloured(grey: Pixels, picture: Pixels): Pixels {
  if (grey.data.length !== picture.data.length) throw new Error('The pictures differ in size.')
  const colours = Array.from({ length: 256 }, (_, level) => colourOf(level / 255))
  const data = new Uint8ClampedArray(grey.data.length)
  for (let i = 0; i < data.length; i += 4) {
    data.set(colours[grey.data[i] ?? 0]!, i)
    data[i + 3] = OPACITY * (picture.data[i + 3] ?? 0)
  }
  return { width: grey.width, height: grey.height, data }
}

/** Whether the server refused a request for confidence because the model has none. */
export function isWithoutConfidence(status: number, problem: Problem | null): boolean {
  return status === 422 && Boolean(problem?.errors?.some(({ pointer }) => pointer === '/outputs'))
}
