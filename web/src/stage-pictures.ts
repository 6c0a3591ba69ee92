import { useEffect, useMemo, useState } from 'preact/hooks'
import { explain, type PageError } from './api/page-error'
import type { RenderRequest } from './api/types'
import { groundRequest, lampLightRequest, onGround, type GroundOutput } from './ground'
import { shining, staged, type Staging } from './lamps'
import { release } from './object-url'
import type { Depths } from './projection'
import { cameraOf, encoded, pixelsOf, rendered, useServed } from './rendered'
import type { SerialQueue } from './serial-queue'

/** Share of the sides of a picture that the depths for a click have. */
const DEPTH_SCALE = 0.5

/** A picture of the model with lamps, and what is on its way. */
export interface StagedPicture {
  url: string | undefined
  blob: Blob | undefined
  /** The request of the shown picture. */
  request: RenderRequest | undefined
  /** What the page waits for, if it waits. */
  waiting: 'picture' | 'ground' | undefined
  error: PageError | undefined
  retry: () => void
}

interface Made {
  url: string
  blob: Blob
  request: RenderRequest
  /** The pictures that it shows, and the colour of the ground. */
  of: unknown[]
}

/** The picture of a request with lamps, over a ground if there is one. */
export function useStaged(model: string, request: RenderRequest | undefined, staging: Staging, queue: SerialQueue): StagedPicture {
  const { floor } = staging
  const ofGround = (output: GroundOutput) => (request && floor ? groundRequest(request, output, staging.height) : undefined)
  const picture = useServed(model, request && staged(request, staging), queue, true)
  const shadow = useServed(model, ofGround('shadow'), queue, false)
  const bounce = useServed(model, ofGround('bounce'), queue, false)
  const [made, setMade] = useState<Made>()
  const [failed, setFailed] = useState<PageError>()
  const lamps = shining(staging)
  const isLit = lamps.length > 0
  const lampLight = useServed(model, request && floor && isLit ? lampLightRequest(request, lamps, staging.height) : undefined, queue, false)
  const grounds = isLit ? [shadow, bounce, lampLight] : [shadow, bounce]
  const of = [picture.blob, shadow.blob, bounce.blob, isLit ? lampLight.blob : undefined, floor]
  const camera = cameraOf(picture.request)
  const isReady = Boolean(camera) && grounds.every((one) => !one.isOld && one.blob && cameraOf(one.request) === camera)
  useEffect(() => {
    const { request, blob } = picture
    if (!floor || !isReady || !request || !blob) return
    let isOver = false
    setFailed(undefined)
    Promise.all([blob, ...grounds.flatMap((one) => one.blob ?? [])].map(pixelsOf))
      .then(([rgb, shadow, bounce, lampLight]) => encoded(onGround(rgb!, { shadow: shadow!, bounce: bounce!, lampLight }, floor)))
      .then((blob) => {
        if (!isOver) setMade({ url: URL.createObjectURL(blob), blob, request, of })
      })
      .catch((error: unknown) => {
        if (!isOver) setFailed(explain(error))
      })
    return () => {
      isOver = true
    }
  }, [isReady, ...of])
  useEffect(() => () => {
    release(made?.url)
  }, [made])
  // Until the ground of another camera has arrived, the picture has none.
  const shown = floor && made && cameraOf(made.request) === camera ? made : picture
  const isGroundOld = Boolean(floor) && of.some((one, i) => one !== made?.of[i])
  const waiting = picture.isOld ? 'picture' : isGroundOld || (floor && !isReady) ? 'ground' : undefined
  const parts = floor ? [picture, ...grounds] : [picture]
  const error = parts.find((one) => one.error)?.error ?? (floor ? failed : undefined)
  const retry = () => parts.filter((one) => one.error).forEach((one) => one.retry())
  return { url: shown.url, blob: shown.blob, request: shown.request, waiting: error ? undefined : waiting, error, retry }
}

async function loadedDepths(model: string, { camera, width, height }: RenderRequest): Promise<Depths> {
  const size = { width: Math.round(DEPTH_SCALE * width), height: Math.round(DEPTH_SCALE * height) }
  const answer = await rendered(model, { camera, ...size, outputs: ['depth'] })
  const [near = 0, far = 0] = (answer.headers.get('relume-depth-range') ?? '').split(/[ ,]+/).map(Number)
  const pixels = await pixelsOf(await answer.blob())
  return { ...size, levels: Uint8Array.from({ length: size.width * size.height }, (_, i) => pixels.data[4 * i] ?? 0), near, far }
}

/** A function that loads the depths of a picture at its first call. */
export function useDepths(model: string, request: RenderRequest | undefined, queue: SerialQueue): () => Promise<Depths | undefined> {
  return useMemo(() => {
    let loading: Promise<Depths> | undefined
    return () => {
      if (!request) return Promise.resolve(undefined)
      loading ??= queue.add(() => loadedDepths(model, request), true)
      loading.catch(() => (loading = undefined))
      return loading
    }
  }, [model, cameraOf(request), queue])
}
