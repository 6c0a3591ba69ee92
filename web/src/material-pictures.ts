import { useEffect, useMemo, useState } from 'preact/hooks'
import type { Material, MaterialEdit, RenderRequest } from './api/types'
import { maskRequest, type Mask } from './materials'
import { release } from './object-url'
import { pixelsOf, rendered } from './rendered'
import type { SerialQueue } from './serial-queue'

/** Delay before the mask of a material is requested at which the pointer rests, milliseconds. */
const REST = 150

/** A mask with the URL of its picture. */
export interface MaskPicture extends Mask {
  url: string
}

/** The masks of the materials after the merges by the camera of one picture. Each is requested once. */
export class Masks {
  readonly #model: string
  readonly #materials: Material[]
  readonly #merges: MaterialEdit[]
  readonly #request: RenderRequest
  readonly #queue: SerialQueue
  readonly #found = new Map<number, Promise<MaskPicture>>()
  #isClosed = false

  constructor(model: string, materials: Material[], merges: MaterialEdit[], request: RenderRequest, queue: SerialQueue) {
    this.#model = model
    this.#materials = materials
    this.#merges = merges
    this.#request = request
    this.#queue = queue
  }

  of(material: number): Promise<MaskPicture> {
    const known = this.#found.get(material)
    if (known) return known
    const found = this.#queue.add(() => this.#load(material))
    this.#found.set(material, found)
    found.catch(() => this.#found.delete(material))
    return found
  }

  all(): Promise<MaskPicture[]> {
    return Promise.all(this.#materials.map(({ material }) => this.of(material)))
  }

  close(): void {
    this.#isClosed = true
    for (const found of this.#found.values()) found.then(({ url }) => release(url), () => {})
  }

  async #load(material: number): Promise<MaskPicture> {
    if (this.#isClosed) throw new DOMException('another picture is shown', 'AbortError')
    const blob = await (await rendered(this.#model, maskRequest(this.#request, this.#materials, material, this.#merges))).blob()
    return { ...(await decoded(blob)), url: URL.createObjectURL(blob) }
  }
}

/** The red channel of a picture. */
async function decoded(blob: Blob): Promise<Mask> {
  const { width, height, data } = await pixelsOf(blob)
  return { width, height, values: Uint8Array.from({ length: width * height }, (_, i) => data[4 * i] ?? 0) }
}

/** The masks for the shown picture. Of the changes of materials only merges change them. */
export function useMasks(model: string, materials: Material[], merges: MaterialEdit[], request: RenderRequest | undefined, queue: SerialQueue): Masks | undefined {
  const camera = request && JSON.stringify([request.camera, request.width, request.height])
  const masks = useMemo(() => (request ? new Masks(model, materials, merges, request, queue) : undefined), [model, materials, camera, queue])
  useEffect(() => () => masks?.close(), [masks])
  return masks
}

/** The URL of the mask of a material, if one is pointed at. */
export function useMask(masks: Masks | undefined, material: number | undefined, onError: (error: unknown) => void): string | undefined {
  const [shown, setShown] = useState<{ masks: Masks; material: number; url: string }>()
  useEffect(() => {
    if (!masks || material === undefined) return
    let isOver = false
    const wait = setTimeout(() => {
      masks.of(material).then(({ url }) => {
        if (!isOver) setShown({ masks, material, url })
      }, (error: unknown) => {
        if (!isOver) onError(error)
      })
    }, REST)
    return () => {
      isOver = true
      clearTimeout(wait)
    }
  }, [masks, material])
  return shown && shown.masks === masks && shown.material === material ? shown.url : undefined
}
