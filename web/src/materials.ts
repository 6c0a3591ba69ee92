import type { EnvironmentSpec, Material, MaterialEdit, NewExport, RenderRequest } from './api/types'

/** The values of a material that the page changes. */
export type MaterialValues = Pick<Material, 'colour' | 'roughness' | 'metalness'>

/** Longest side of a mask, pixels. */
const MASK_SIDE = 160
/** Least sum of all masks at a pixel of the surface; off the surface it is 0, on the surface 255. */
const SURFACE = 128

/** One channel of a picture, 0 to 255, row by row. */
export interface Mask {
  width: number
  height: number
  values: Uint8Array
}

/** Whether a model has materials, by the rule of the server (crates/scene/src/model.rs). */
export function hasMaterials(card: unknown): boolean {
  const { config, imported } = card as { config?: { warm_up?: unknown } | null; imported?: { materials?: unknown } | null }
  const isOfColourAlone = typeof config?.warm_up === 'number' && config.warm_up >= 1
  return !isOfColourAlone && imported?.materials !== false
}

/** The values of a material after the changes. */
export function valuesOf({ material, colour, roughness, metalness }: Material, edits: MaterialEdit[]): MaterialValues {
  const edit = edits.find((one) => one.material === material)
  return { colour: edit?.colour ?? colour, roughness: edit?.roughness ?? roughness, metalness: edit?.metalness ?? metalness }
}

/** The changes with another change of one material: one item for each changed material, by number. */
export function changed(edits: MaterialEdit[], { material, colour }: Material, some: Partial<MaterialValues>): MaterialEdit[] {
  const edit: MaterialEdit = { ...(edits.find((one) => one.material === material) ?? { material }), ...some }
  // The material's own colour leaves the albedo as it is. A constant roughness does not: the material's own one varies.
  if (edit.colour === colour) delete edit.colour
  const others = undone(edits, material)
  return Object.keys(edit).length > 1 ? [...others, edit].sort((a, b) => a.material - b.material) : others
}

/** The changes without those of one material and without the merges into it. */
export function undone(edits: MaterialEdit[], material: number): MaterialEdit[] {
  return edits.filter((one) => one.material !== material && one.into !== material)
}

/** The merges among the changes. */
export function mergesOf(edits: MaterialEdit[]): MaterialEdit[] {
  return edits.filter(({ into }) => typeof into === 'number')
}

/** The changes with a merge of one material into another. No merge leads to a merged material, so that their order is irrelevant. */
export function merged(edits: MaterialEdit[], material: number, into: number): MaterialEdit[] {
  const others = edits.filter((one) => one.material !== material).map((one) => (one.into === material ? { ...one, into } : one))
  return [...others, { material, into }].sort((a, b) => a.material - b.material)
}

/** The materials after the merges. A material into which others are merged has the mean values of all of them, by their shares. */
export function afterMerges(materials: Material[], edits: MaterialEdit[]): Material[] {
  const merges = mergesOf(edits)
  const isMerged = ({ material }: Material) => merges.some((one) => one.material === material)
  return materials.filter((one) => !isMerged(one)).map((one) => {
    const parts = [one, ...materials.filter(({ material }) => merges.some((merge) => merge.material === material && merge.into === one.material))]
    return parts.length > 1 ? meanOf(one.material, parts) : one
  })
}

function meanOf(material: number, parts: Material[]): Material {
  const share = parts.reduce((sum, part) => sum + part.share, 0)
  const mean = (value: (part: Material) => number) => parts.reduce((sum, part) => sum + part.share * value(part), 0) / (share || 1)
  const albedo = [0, 1, 2].map((c) => mean((part) => part.albedo[c] ?? 0))
  return { material, albedo, colour: colourOf(albedo), share, roughness: mean((part) => part.roughness), metalness: mean((part) => part.metalness) }
}

/** The sRGB colour of a linear one, `#rrggbb`. */
function colourOf(linear: number[]): string {
  const level = (value: number) => Math.round(255 * (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055))
  return `#${linear.map((value) => level(Math.min(1, Math.max(0, value))).toString(16).padStart(2, '0')).join('')}`
}

/** The changes as a file for the option `--edits` of `relume`. */
export function editsFile(edits: MaterialEdit[]): string {
  return `${JSON.stringify(edits, null, 2)}\n`
}

/** Kinds of exports with the colours of the photographs, which changes of materials do not alter. With changes they are lit. */
export function isLitByChanges(kind: string): boolean {
  return kind === 'gltf' || kind === 'usdz'
}

/** An export of the model with the changes. Photographs without their light have none. */
export function exportWith(request: NewExport, edits: MaterialEdit[], light: EnvironmentSpec): NewExport {
  if (edits.length === 0 || request.kind === 'delight') return request
  return { ...request, ...(isLitByChanges(request.kind) ? { environment: light } : {}), materials: edits }
}

/**
 * The request for a mask of one material by the camera of a picture: white where the surface has only this material. The mask is
 * the roughness of the model if this material has the roughness 1 and all others 0, because the mask of the API has no free camera.
 * The metalness of the same model is the mask of the next material: the server prepares each changed model anew, which takes
 * longer than a picture. `materials` are those after the `merges`.
 */
export function maskRequest({ camera, width, height }: RenderRequest, materials: Material[], material: number, merges: MaterialEdit[]): RenderRequest {
  const scale = Math.min(1, MASK_SIDE / Math.max(width, height))
  const index = materials.findIndex((one) => one.material === material)
  const [rough, metallic] = [index - (index % 2), index - (index % 2) + 1]
  return {
    camera,
    width: Math.round(width * scale),
    height: Math.round(height * scale),
    outputs: [index === rough ? 'roughness' : 'metallic'],
    materials: [...merges, ...materials.map((one, i) => ({ material: one.material, roughness: i === rough ? 1 : 0, metalness: i === metallic ? 1 : 0 }))],
  }
}

/** The index of the mask that is brightest at a point (shares of width and height, 0 to 1). Undefined where there is no surface. */
export function brightest(masks: Mask[], [x, y]: [number, number]): number | undefined {
  const values = masks.map(({ width, height, values }) => {
    const [column, row] = [Math.min(width - 1, Math.floor(x * width)), Math.min(height - 1, Math.floor(y * height))]
    return values[row * width + column] ?? 0
  })
  const sum = values.reduce((sum, value) => sum + value, 0)
  return sum < SURFACE ? undefined : values.indexOf(Math.max(...values))
}
