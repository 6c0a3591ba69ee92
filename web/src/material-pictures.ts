import { useEffect, useMemo, useRef, useState } from 'preact/hooks'
import { ask } from './api/client'
import { explain, type PageError } from './api/page-error'
import type { Material, RenderRequest } from './api/types'
import { maskRequest, type Mask } from './materials'
import { release } from './object-url'
import type { SerialQueue } from './serial-queue'

/** Delay between the last change and the request for its picture, milliseconds. */
const SETTLE = 250
/** Delay before the mask of a material is requested at which the pointer rests, milliseconds. */
const REST = 150

/** A mask with the URL of its picture. */
export interface MaskPicture extends Mask {
  url: string
}

/** A picture of the server and the request that it answers, and the last request that failed. */
interface Served {
  request?: RenderRequest
  url?: string
  failed?: { body: string; error: PageError }
}

async function rendered(model: string, request: RenderRequest): Promise<Blob> {
  const headers = { 'Content-Type': 'application/json', Accept: 'image/png' }
  const answer = await ask(`v1/models/${encodeURIComponent(model)}/render`, { method: 'POST', body: JSON.stringify(request), headers })
  return answer.blob()
}

/** The picture of a request. The previous picture stays until the new one has arrived. In `queue` it comes before masks. */
export function useServed(model: string, request: RenderRequest | undefined, queue: SerialQueue) {
  const [shown, setShown] = useState<Served>({})
  const [round, setRound] = useState(0)
  const isGone = useRef(false)
  useEffect(() => () => {
    isGone.current = true
  }, [])
  const body = request && JSON.stringify(request)
  useEffect(() => {
    if (!body) return
    let isReplaced = false
    const request = JSON.parse(body) as RenderRequest
    const show = async () => {
      if (isReplaced) return
      try {
        const blob = await rendered(model, request)
        if (!isGone.current) setShown({ request, url: URL.createObjectURL(blob) })
      } catch (error) {
        setShown((before) => ({ ...before, failed: { body, error: explain(error) } }))
      }
    }
    const wait = setTimeout(() => void queue.add(show, true), SETTLE)
    return () => {
      isReplaced = true
      clearTimeout(wait)
    }
  }, [model, body, queue, round])
  useEffect(() => () => {
    release(shown.url)
  }, [shown.url])
  const isOld = body !== undefined && body !== JSON.stringify(shown.request)
  const error = isOld && shown.failed?.body === body ? shown.failed.error : undefined
  const retry = () => {
    setShown(({ failed: _, ...before }) => before)
    setRound((n) => n + 1)
  }
  return { request: shown.request, url: shown.url, isOld, error, retry }
}

/** The masks of the materials by the camera of one picture. Each is requested once. */
export class Masks {
  readonly #model: string
  readonly #materials: Material[]
  readonly #request: RenderRequest
  readonly #queue: SerialQueue
  readonly #found = new Map<number, Promise<MaskPicture>>()
  #isClosed = false

  constructor(model: string, materials: Material[], request: RenderRequest, queue: SerialQueue) {
    this.#model = model
    this.#materials = materials
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
    const blob = await rendered(this.#model, maskRequest(this.#request, this.#materials, material))
    return { ...(await decoded(blob)), url: URL.createObjectURL(blob) }
  }
}

/** The red channel of a picture. */
async function decoded(blob: Blob): Promise<Mask> {
  const picture = await createImageBitmap(blob, { premultiplyAlpha: 'none', colorSpaceConversion: 'none' })
  const { width, height } = picture
  const context = new OffscreenCanvas(width, height).getContext('2d')
  if (!context) throw new Error('This browser cannot read a picture.')
  context.drawImage(picture, 0, 0)
  picture.close()
  const { data } = context.getImageData(0, 0, width, height)
  return { width, height, values: Uint8Array.from({ length: width * height }, (_, i) => data[4 * i] ?? 0) }
}

/** The masks for the shown picture. Changes of materials do not change them. */
export function useMasks(model: string, materials: Material[], request: RenderRequest | undefined, queue: SerialQueue): Masks | undefined {
  const camera = request && JSON.stringify([request.camera, request.width, request.height])
  const masks = useMemo(() => (request ? new Masks(model, materials, request, queue) : undefined), [model, materials, camera, queue])
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
