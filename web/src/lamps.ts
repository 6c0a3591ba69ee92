import type { Lamp, NewExport, RenderRequest } from './api/types'

export type Point = [number, number, number]

/** A lamp of the page. */
export interface PlacedLamp {
  lamp: Lamp
  /** Whether the lamp shines. */
  isOn: boolean
}

/** What the page adds to the model: lamps, and the ground below the model. */
export interface Staging {
  lamps: PlacedLamp[]
  /** Whether shadows are traced in each pixel (the tier `high`). */
  isSharp: boolean
  /** Colour of the ground, `#rrggbb`. Undefined: there is no ground. */
  floor: string | undefined
  /** Height of the ground, capture units. Undefined: the lowest visible point of the model. */
  height: number | undefined
}

export const BARE: Staging = { lamps: [], isSharp: false, floor: undefined, height: undefined }

/** Greatest number of lamps on the page. */
export const MOST_LAMPS = 4
/** Outputs of the light of lamps on the ground. */
const LAMP_OUTPUTS = ['lamp_light', 'lamp_shadow'] as const
/** Colour temperatures of the API, kelvin. */
export const KELVIN = { least: 1700, most: 20_000 } as const

/** The shapes of lamps with their labels. */
export const SHAPES = [['point', 'bulb'], ['spot', 'spot'], ['disc', 'disc'], ['rectangle', 'soft box']] as const

/** Colour temperature of a new lamp, kelvin. */
const WARM = 3200
/** Full angle of the cone of a new spot, degrees. */
const CONE = 45
/** Radius of a new lamp as a share of its distance from the point that it lights. */
const SIZE = 0.08

/** Irradiance of a surface at the target of a new lamp. A white surface is then half as bright as a map of radiance 1. */
const IRRADIANCE = Math.PI / 2

/** A number with as many digits as the address has. */
export const short = (value: number): number => Number(value.toPrecision(4))

const distance = (a: number[], b: number[]): number => Math.hypot(...a.map((value, k) => value - (b[k] ?? 0)))

/** A point with a thousandth of a length as its precision. */
export function snapped(point: number[], length: number): number[] {
  const digits = Math.min(20, Math.max(0, 3 - Math.floor(Math.log10(length))))
  // The sum makes 0 of -0.
  return point.map((value) => Number(value.toFixed(digits)) + 0)
}

/** A new bulb at a position for a subject at `target`. */
export function newLamp(position: Point, target: Point): Lamp {
  const far = distance(position, target)
  return {
    shape: 'point',
    position: snapped(position, far),
    radius: Number((SIZE * far).toPrecision(1)),
    intensity: Number((IRRADIANCE * far * far).toPrecision(2)),
    kelvin: WARM,
  }
}

/** A lamp with another shape. It faces `towards` if it faced no point before. */
export function reshaped({ target, radius, size, cone_deg, ...lamp }: Lamp, shape: Lamp['shape'], towards: Point): Lamp {
  const round = radius ?? Math.min(...(size ?? [0])) / 2
  const facing = { target: target ?? snapped(towards, distance(lamp.position, towards)) }
  switch (shape) {
    case 'point':
      return { ...lamp, shape, radius: round }
    case 'spot':
      return { ...lamp, shape, ...facing, radius: round, cone_deg: cone_deg ?? CONE }
    case 'disc':
      return { ...lamp, shape, ...facing, radius: round }
    case 'rectangle': {
      const side = round > 0 ? 2 * round : Number((SIZE * distance(lamp.position, facing.target)).toPrecision(1))
      return { ...lamp, shape, ...facing, size: size ?? [short(2 * side), short(side)] }
    }
  }
}

/** A lamp with another colour: a colour temperature, or a colour in sRGB. */
export function coloured({ kelvin: _, colour: __, ...lamp }: Lamp, chosen: { kelvin: number } | { colour: string }): Lamp {
  return { ...lamp, ...chosen }
}

/** A lamp as text: the shape, then its values, as in the option `--lamp` of `relume render`. */
export function lampText(lamp: Lamp): string {
  const list = (values: number[]) => values.map(short).join()
  const values: [string, string | undefined][] = [
    ['position', list(lamp.position)],
    ['target', lamp.target ? list(lamp.target) : undefined],
    ['radius', lamp.radius ? String(short(lamp.radius)) : undefined],
    ['size', lamp.size ? list(lamp.size) : undefined],
    ['cone', lamp.cone_deg ? String(short(lamp.cone_deg)) : undefined],
    ['kelvin', lamp.kelvin ? String(lamp.kelvin) : undefined],
    ['colour', lamp.colour ?? undefined],
    ['intensity', String(short(lamp.intensity ?? 0))],
  ]
  return [lamp.shape, ...values.filter(([, value]) => value !== undefined).map(([key, value]) => `${key}=${value}`)].join(' ')
}

/** The lamp of a text. Undefined if it is none that the API takes. */
export function readLamp(text: string): Lamp | undefined {
  const [word = '', ...pairs] = text.trim().split(/\s+/)
  const shape = SHAPES.find(([name]) => name === word)?.[0]
  const given = new Map(pairs.map((pair) => pair.split('=', 2) as [string, string | undefined]))
  const numbers = (key: string, amount: number) => {
    const values = (given.get(key) ?? '').split(',').map((value) => (value === '' ? NaN : Number(value)))
    return values.length === amount && values.every(Number.isFinite) ? values : undefined
  }
  const one = (key: string, least: number, most: number, otherwise: number) => Math.min(most, Math.max(least, numbers(key, 1)?.[0] ?? otherwise))
  const [position, target, size] = [numbers('position', 3), numbers('target', 3), numbers('size', 2)]
  if (!shape || !position || (shape !== 'point' && (!target || distance(position, target) === 0))) return undefined
  if (shape === 'rectangle' && !size?.every((side) => side > 0)) return undefined
  const colour = given.get('colour')
  return {
    shape,
    position,
    ...(shape !== 'point' && target ? { target } : {}),
    ...(shape === 'rectangle' && size ? { size } : { radius: one('radius', 0, 1e6, 0) }),
    ...(shape === 'spot' ? { cone_deg: one('cone', 1, 179, CONE) } : {}),
    ...(colour && /^#[0-9a-f]{6}$/i.test(colour) ? { colour } : { kelvin: one('kelvin', KELVIN.least, KELVIN.most, WARM) }),
    intensity: one('intensity', 0, 1e12, 1),
  }
}

/** The lamps and the ground in the query of an address. */
export function readStaging(query: URLSearchParams): Staging {
  const lamps = (query.get('lamps') ?? '').split(';').flatMap((text): PlacedLamp[] => {
    const lamp = readLamp(text.replace(/^off /, ''))
    return lamp ? [{ lamp, isOn: !text.startsWith('off ') }] : []
  })
  const [floor, ground] = [query.get('floor') ?? '', query.get('ground')]
  const height = ground ? Number(ground) : NaN
  return {
    lamps: lamps.slice(0, MOST_LAMPS),
    isSharp: query.get('shadows') === 'sharp',
    floor: /^#[0-9a-f]{6}$/i.test(floor) ? floor : undefined,
    height: Number.isFinite(height) ? height : undefined,
  }
}

/** The query that restores lamps and ground. Default values are left out. */
export function writtenStaging({ lamps, isSharp, floor, height }: Staging): Record<string, string> {
  return {
    ...(lamps.length > 0 ? { lamps: lamps.map(({ lamp, isOn }) => `${isOn ? '' : 'off '}${lampText(lamp)}`).join(';') } : {}),
    ...(isSharp ? { shadows: 'sharp' } : {}),
    ...(floor ? { floor } : {}),
    ...(height !== undefined ? { ground: String(height) } : {}),
  }
}

/** The lamps that shine, as the API takes them. */
export function shining({ lamps }: Staging): Lamp[] {
  return lamps.filter(({ isOn }) => isOn).map(({ lamp }) => lamp)
}

/** A render request for a picture with the lamps that shine. With a ground it has no other background. */
export function staged(request: RenderRequest, staging: Staging): RenderRequest {
  const lamps = shining(staging)
  return {
    ...request,
    ...(lamps.length > 0 ? { lamps } : {}),
    ...(staging.isSharp ? { tier: 'high' } : {}),
    ...(staging.floor ? { background: 'transparent' } : {}),
  }
}

/** An export of frames with the lamps that shine, their light on the ground and the height of the ground. Other exports have none of these. */
export function exportStaged(request: NewExport, staging: Staging): NewExport {
  if (request.kind !== 'frames') return request
  const lamps = shining(staging)
  const isOfGround = request.outputs?.includes('shadow')
  return {
    ...request,
    ...(lamps.length > 0 ? { lamps } : {}),
    ...(lamps.length > 0 && isOfGround ? { outputs: [...(request.outputs ?? []), ...LAMP_OUTPUTS] } : {}),
    ...(staging.isSharp ? { tier: 'high' } : {}),
    ...(isOfGround && staging.height !== undefined ? { ground_height: staging.height } : {}),
  }
}
