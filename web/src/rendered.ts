import { useEffect, useRef, useState } from 'preact/hooks'
import { ask, Refused } from './api/client'
import { explain, type PageError } from './api/page-error'
import type { RenderRequest } from './api/types'
import type { Pixels } from './ground'
import { release } from './object-url'
import type { SerialQueue } from './serial-queue'

/** Delay between the last change and the request for its picture, milliseconds. */
const SETTLE = 250

/** A picture of the server and the request that it answers, and the last request that failed. */
interface Served {
  request?: RenderRequest
  blob?: Blob
  url?: string
  failed?: { body: string; error: PageError; refused: Refused | undefined }
}

/** The answer to a render request: a PNG. */
export function rendered(model: string, request: RenderRequest): Promise<Response> {
  const headers = { 'Content-Type': 'application/json', Accept: 'image/png' }
  return ask(`v1/models/${encodeURIComponent(model)}/render`, { method: 'POST', body: JSON.stringify(request), headers })
}

/** The pixels of a picture. */
export async function pixelsOf(blob: Blob): Promise<ImageData> {
  const picture = await createImageBitmap(blob, { premultiplyAlpha: 'none', colorSpaceConversion: 'none' })
  const { width, height } = picture
  const context = new OffscreenCanvas(width, height).getContext('2d')
  if (!context) throw new Error('This browser cannot read a picture.')
  context.drawImage(picture, 0, 0)
  picture.close()
  return context.getImageData(0, 0, width, height)
}

/** A picture of pixels: a PNG. */
export async function encoded({ width, height, data }: Pixels): Promise<Blob> {
  const canvas = new OffscreenCanvas(width, height)
  const context = canvas.getContext('2d')
  if (!context) throw new Error('This browser cannot make a picture.')
  const pixels = context.createImageData(width, height)
  pixels.data.set(data)
  context.putImageData(pixels, 0, 0)
  return canvas.convertToBlob({ type: 'image/png' })
}

/** The camera and the size of a request, as text. */
export const cameraOf = (request: RenderRequest | undefined) => request && JSON.stringify([request.camera, request.width, request.height])

/** The picture of a request. The previous picture stays until the new one has arrived. In `queue` an urgent one comes before others. */
export function useServed(model: string, request: RenderRequest | undefined, queue: SerialQueue, isUrgent: boolean) {
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
        const blob = await (await rendered(model, request)).blob()
        if (!isGone.current) setShown({ request, blob, url: URL.createObjectURL(blob) })
      } catch (error) {
        setShown((before) => ({ ...before, failed: { body, error: explain(error), refused: error instanceof Refused ? error : undefined } }))
      }
    }
    const wait = setTimeout(() => void queue.add(show, isUrgent), SETTLE)
    return () => {
      isReplaced = true
      clearTimeout(wait)
    }
  }, [model, body, queue, round, isUrgent])
  useEffect(() => () => {
    release(shown.url)
  }, [shown.url])
  const isOld = body !== undefined && body !== JSON.stringify(shown.request)
  const failed = isOld && shown.failed?.body === body ? shown.failed : undefined
  const retry = () => {
    setShown(({ failed: _, ...before }) => before)
    setRound((n) => n + 1)
  }
  return { request: shown.request, blob: shown.blob, url: shown.url, isOld, error: failed?.error, refused: failed?.refused, retry }
}
