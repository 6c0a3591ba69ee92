import type { Camera, DelightExport, EnvironmentSpec, Export, NewExport, RenderRequest } from './api/types'

/** The display settings of a model, which the URL of its page stores. */
export interface Look {
  /** A built-in map, `recovered`, or the identifier of an uploaded one. */
  light: string
  /** Degrees. */
  rotation: number
  /** Stops. */
  exposure: number
  background: string
  output: string
}

/** The camera of a viewer. */
export interface View {
  /** Degrees from the first photograph if the model records it, as the API counts it. */
  azimuth: number
  elevation: number
  distance: number
  /** Position, capture units. */
  eye: [number, number, number]
  target: [number, number, number]
  fov: number
}

export const PLAIN: Look = { light: 'studio', rotation: 0, exposure: 0, background: 'transparent', output: 'rgb' }

export const OUTPUTS = ['rgb', 'albedo', 'normal', 'roughness', 'metalness', 'ao', 'depth'] as const

/** The lights that the page of a shared model offers, with their labels. */
export const SHARED_LIGHTS = [
  ['recovered', 'captured'], ['studio', 'studio'], ['sunset', 'sunset'], ['overcast', 'overcast'], ['dawn', 'dawn'], ['night', 'night'],
] as const

/** Outputs whose names differ in the API. */
const API_OUTPUTS: Record<string, string> = { metalness: 'metallic', ao: 'visibility' }

/** Names of the camera parameters in a URL. */
const VIEW = ['azimuth', 'elevation', 'distance', 'fov'] as const
export type ViewAttributes = Partial<Record<(typeof VIEW)[number], number>> & { target?: string }

export function readLook(query: URLSearchParams): Look {
  const number = (name: string) => Number(query.get(name)) || 0
  return {
    light: query.get('light') ?? PLAIN.light,
    rotation: number('rotation'),
    exposure: number('exposure'),
    background: query.get('background') ?? PLAIN.background,
    output: query.get('output') ?? PLAIN.output,
  }
}

export function readView(query: URLSearchParams): ViewAttributes {
  const given = VIEW.filter((name) => query.has(name) && Number.isFinite(Number(query.get(name))))
  const target = query.get('target')
  return { ...Object.fromEntries(given.map((name) => [name, Number(query.get(name))])), ...(target ? { target } : {}) }
}

/** A point with a thousandth of the distance of the camera as its precision. */
function rounded(point: number[], { distance }: View): number[] {
  const digits = Math.min(20, Math.max(0, 3 - Math.floor(Math.log10(distance))))
  return point.map((value) => Number(value.toFixed(digits)))
}

/** The URL query that restores a look and a view, with rounded numbers. Default values are left out, and so is `centre`, the target of the first view. */
export function written(look: Look, view: View | undefined, centre: View['target'] | undefined): Record<string, string> {
  const query: Record<string, string> = {}
  for (const [name, value] of Object.entries(look)) if (value !== PLAIN[name as keyof Look]) query[name] = String(value)
  if (view) {
    for (const name of ['azimuth', 'elevation', 'fov'] as const) query[name] = String(Math.round(10 * view[name]) / 10)
    const round = (value: number) => String(Number(value.toPrecision(3)))
    query.distance = round(view.distance)
    if (String(view.target) !== String(centre)) query.target = rounded(view.target, view).join()
  }
  return query
}

/** The background of an output. The light is a background of the output `rgb` only; other outputs are transparent instead. */
export function backgroundOf({ background, output }: Look): string {
  return background === 'environment' && output !== 'rgb' ? 'transparent' : background
}

/** The environment of a render request for a look. */
export function environment(look: Look, builtin: string[]): NonNullable<RenderRequest['environment']> {
  const light = look.light === 'recovered' || builtin.includes(look.light) ? { builtin: look.light } : { id: look.light }
  return { ...light, rotation_deg: look.rotation, exposure_ev: look.exposure }
}

/** The render request for the picture of a viewer. */
export function requestOf(look: Look, view: View, builtin: string[], [width, height]: [number, number]): RenderRequest {
  const camera = { look_at: { eye: rounded(view.eye, view), target: rounded(view.target, view), up: [0, 0, 1], fov_y_deg: Number(view.fov.toFixed(2)) } }
  return { camera, environment: environment(look, builtin), width, height, outputs: [API_OUTPUTS[look.output] ?? look.output], background: backgroundOf(look) }
}

/** The outputs of an export for a compositor: the picture and the factors of the ground. */
const LAYER_OUTPUTS = ['rgb', 'depth', 'shadow', 'bounce', 'contact']

/** The labels of the exports. */
export const TAKEN = {
  video: 'Turntable, video (mp4)',
  frames: 'Turntable, pictures (zip of png)',
  layers: 'Turntable, layers with the shadow (zip of exr)',
  gltf: 'glTF with Gaussians (.glb)',
  usdz: 'OpenUSD with Gaussians (.usdz)',
  ply: 'PLY, relightable',
  relit: 'PLY, as lit here',
  mesh: 'Mesh with textures (.glb)',
  delight: 'Photographs without their light (zip)',
} as const

/** What an export shows, for the list of exports. `lightName` names the light of its request. */
export function exportName(of: Export, lightName: (light: EnvironmentSpec | null | undefined) => string): string {
  const isChanged = Boolean(of.request && 'materials' in of.request && of.request.materials?.length)
  const hasLamps = of.request?.kind === 'frames' && Boolean(of.request.lamps?.length)
  const most = of.request && 'max_splats' in of.request ? of.request.max_splats : undefined
  return `${contentOf(of, lightName)}${most ? `, at most ${most} Gaussians` : ''}${hasLamps ? ', with lamps' : ''}${isChanged ? ', materials changed' : ''}`
}

function contentOf({ kind, request, progress }: Export, lightName: (light: EnvironmentSpec | null | undefined) => string): string {
  if (request?.kind === 'frames') {
    const what = `${request.turntable ? 'Turntable' : 'Camera path'}, ${request.package === 'mp4' ? 'video' : request.format === 'exr' ? 'layers' : 'pictures'}`
    const size = request.width && request.height ? `, ${request.width} × ${request.height} px` : ''
    return `${what}, ${progress.total} frames${size}, ${lightName(request.environment)}`
  }
  if (request?.kind === 'light_matrix') {
    const size = request.width && request.height ? `, ${request.width} × ${request.height} px` : ''
    return `Light matrix, ${request.lobes ?? 128} lobes${progress.total > 1 ? `, ${progress.total} cameras` : ''}${size}`
  }
  if (request?.kind === 'delight') {
    const amount = request.photographs ? `, ${request.photographs.length} chosen` : ''
    return `Photographs without their light, ${String(request.format ?? 'exr').toUpperCase()}${amount}${request.resolution ? `, longest side ${request.resolution} px` : ''}`
  }
  if (request && 'environment' in request && request.environment) return `${kind.toUpperCase()}, ${lightName(request.environment)}`
  return kind in TAKEN ? TAKEN[kind as keyof typeof TAKEN].replace(/ \(.*\)$/, '') : kind
}

/** The request for an export under the light of a look. A turntable begins at the camera of the view. */
export function exportOf(what: keyof typeof TAKEN, look: Look, view: View | undefined, builtin: string[], frames: number, side: number): NewExport {
  switch (what) {
    case 'video':
    case 'frames':
    case 'layers': {
      const from = view ? { azimuth_deg: view.azimuth, elevation_deg: view.elevation } : {}
      const turntable = { kind: 'frames', turntable: { frames, ...from }, environment: environment(look, builtin), width: side, height: side } as const
      if (what === 'layers') return { ...turntable, outputs: LAYER_OUTPUTS, format: 'exr', background: 'transparent', package: 'zip' }
      return { ...turntable, outputs: [API_OUTPUTS[look.output] ?? look.output], background: backgroundOf(look), package: what === 'video' ? 'mp4' : 'zip' }
    }
    case 'relit':
      return { kind: 'ply', layer: 'relit', environment: environment(look, builtin) }
    case 'mesh':
      return { kind: 'mesh' }
    default:
      return { kind: what }
  }
}

/** Whether an export has the Gaussians of the model, of which it can leave out some. */
export function hasGaussians(what: keyof typeof TAKEN): boolean {
  return what === 'gltf' || what === 'usdz' || what === 'ply' || what === 'relit'
}

/** An export of Gaussians with at most `most` of them. Undefined: all. Other exports stay as they are. */
export function exportWithin(request: NewExport, most: number | undefined): NewExport {
  if (most === undefined || request.kind === 'frames' || request.kind === 'mesh' || request.kind === 'light_matrix' || request.kind === 'delight') return request
  return { ...request, max_splats: most }
}

/** File format of the layers of photographs without their light. */
export type DelightFormat = 'exr' | 'png'
/** Longest sides of these layers in the API, pixels. */
export const DELIGHT_SIDE = { least: 16, most: 8192 } as const

/** An export of photographs without their light, with a format and a longest side. Undefined: the size of the photographs. Other exports stay as they are. */
export function exportDelight(request: NewExport, format: DelightFormat, side: number | undefined): NewExport {
  if (request.kind !== 'delight') return request
  return { ...request, format: format as NonNullable<DelightExport['format']>, ...(side === undefined ? {} : { resolution: side }) }
}

/** The render request for the camera of a photograph. */
export function requestAt(look: Look, { camera, width, height }: Camera, builtin: string[], longest: number): RenderRequest {
  const scale = Math.min(1, longest / Math.max(width, height))
  const size = { width: Math.round(width * scale), height: Math.round(height * scale) }
  const [sx, sy] = [size.width / width, size.height / height]
  const pinhole = camera.intrinsics
  const intrinsics = pinhole ? { fx: pinhole.fx * sx, fy: pinhole.fy * sy, cx: pinhole.cx * sx, cy: pinhole.cy * sy } : null
  return { camera: { camera_to_world: camera.camera_to_world ?? null, ...(intrinsics ? { intrinsics } : {}) }, environment: environment(look, builtin), ...size, outputs: ['rgb'], background: 'transparent' }
}

/** The render request as a curl command. */
export function curl(url: string, request: RenderRequest, hasKey: boolean): string {
  const key = hasKey ? " \\\n  -H \"Authorization: Bearer $RELUME_API_KEY\"" : ''
  return `curl -o frame.png -H 'Content-Type: application/json' -H 'Accept: image/png'${key} \\\n  -d '${JSON.stringify(request)}' \\\n  ${url}`
}
