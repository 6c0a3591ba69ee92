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

/** The changes without those of one material. */
export function undone(edits: MaterialEdit[], material: number): MaterialEdit[] {
  return edits.filter((one) => one.material !== material)
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
 * longer than a picture.
 */
export function maskRequest({ camera, width, height }: RenderRequest, materials: Material[], material: number): RenderRequest {
  const scale = Math.min(1, MASK_SIDE / Math.max(width, height))
  const index = materials.findIndex((one) => one.material === material)
  const [rough, metallic] = [index - (index % 2), index - (index % 2) + 1]
  return {
    camera,
    width: Math.round(width * scale),
    height: Math.round(height * scale),
    outputs: [index === rough ? 'roughness' : 'metallic'],
    materials: materials.map((one, i) => ({ material: one.material, roughness: i === rough ? 1 : 0, metalness: i === metallic ? 1 : 0 })),
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
