import { useEffect, useMemo, useState } from 'preact/hooks'
import { explain, type PageError } from '../api/page-error'
import type { Environments, Model } from '../api/types'
import { coloured, confidenceRequest, GRADIENT, isWithoutConfidence } from '../confidence'
import { requestOf, type Look, type View } from '../look'
import { release } from '../object-url'
import { cameraOf, encoded, pixelsOf, useServed } from '../rendered'
import { SerialQueue } from '../serial-queue'
import { Failure } from './common'
import { CameraMarks, PlaceList, usePlaces, type Places, type Turn } from './next-photographs'
import { lookAtOf } from './stage-picture'

/** Width and height of the picture, pixels. */
const SIZE: [number, number] = [640, 480]
const ASPECT = SIZE[0] / SIZE[1]

interface ConfidenceProps {
  model: Model
  look: Look
  view: View | undefined
  lights: Environments | undefined
  onTurn: Turn
}

/** The confidence of a model in its parts. Nothing is loaded before the panel is opened. */
export function Confidence(props: ConfidenceProps) {
  const { model, view, lights } = props
  const [isOpen, setOpen] = useState(false)
  const [hasPlaces, setPlaces] = useState(false)
  const isListed = isOpen && hasPlaces
  const places = usePlaces(model.id, isListed)
  const list = () => {
    setOpen(true)
    setPlaces(!isListed)
  }
  return (
    <section class="card stack confidence" aria-labelledby="confidence">
      <h2 id="confidence">Confidence</h2>
      <p class="small muted">Colours show how well the photographs determine the materials at each point. The next photographs should show what has a low confidence.</p>
      <div class="row">
        <button type="button" aria-expanded={isOpen} onClick={() => setOpen(!isOpen)}>{isOpen ? 'Hide the confidence' : 'Show the confidence'}</button>
        <button type="button" aria-expanded={isListed} onClick={list}>{isListed ? 'Hide the places' : 'Where to photograph next'}</button>
      </div>
      {isOpen && view && lights ? <Opened {...props} view={view} lights={lights} places={isListed ? places : undefined} /> : null}
    </section>
  )
}

interface OpenedProps extends ConfidenceProps {
  view: View
  lights: Environments
  /** The places for further photographs, if they are listed. */
  places: Places | undefined
}

function Opened({ model, look, view, lights, places, onTurn }: OpenedProps) {
  const [isShown, setShown] = useState(true)
  const queue = useMemo(() => new SerialQueue(), [])
  const request = requestOf({ ...look, output: 'rgb', background: 'transparent' }, view, lights.builtin, SIZE)
  const grey = useServed(model.id, confidenceRequest(request), queue, true)
  const isWithout = Boolean(grey.refused && isWithoutConfidence(grey.refused.status, grey.refused.problem))
  const picture = useServed(model.id, isWithout ? undefined : request, queue, false)
  const isOfOneCamera = cameraOf(grey.request) === cameraOf(picture.request)
  const colours = useColours(isOfOneCamera ? grey.blob : undefined, isOfOneCamera ? picture.blob : undefined)
  const error = grey.error ?? picture.error ?? colours.error
  if (isWithout) return <p role="status">This model has no confidence. A training with this version of Relume measures it; models of earlier versions and imported models have none.</p>
  const isWaiting = (grey.isOld || picture.isOld) && !error
  const camera = lookAtOf(picture)
  return (
    <>
      <div class="edited" style={{ aspectRatio: `${SIZE[0]} / ${SIZE[1]}` }}>
        {picture.url ? <img class={colours.url && isShown ? 'under' : ''} src={picture.url} alt="The model in the current view" /> : null}
        {colours.url && isShown ? <img class="colours" src={colours.url} alt="Its confidence: orange where it is low, blue where it is high" /> : null}
        {camera && places?.answer ? <CameraMarks places={places.answer.cameras} camera={camera} aspect={ASPECT} onTurn={onTurn} /> : null}
        {isWaiting ? <p class="late"><span class="spinner" />The confidence is on its way</p> : null}
      </div>
      <label class="check"><input type="checkbox" checked={isShown} onChange={(event) => setShown(event.currentTarget.checked)} />Confidence over the picture</label>
      <div class="scale small">
        <i style={{ background: GRADIENT }} />
        <span>low: guess</span>
        <span>high: well determined</span>
      </div>
      <Failure error={error} retry={() => [grey, picture].filter((one) => one.error).forEach((one) => one.retry())} />
      {places ? <PlaceList model={model} places={places} view={view} aspect={ASPECT} onTurn={onTurn} /> : null}
    </>
  )
}

/** The colours of a confidence over a picture, if both are there. */
function useColours(grey: Blob | undefined, picture: Blob | undefined): { url: string | undefined; error: PageError | undefined } {
  const [made, setMade] = useState<{ of: (Blob | undefined)[]; url?: string; error?: PageError }>()
  useEffect(() => {
    if (!grey || !picture) return
    let isOver = false
    const of = [grey, picture]
    Promise.all(of.map(pixelsOf))
      .then(([grey, picture]) => encoded(coloured(grey!, picture!)))
      .then((blob) => {
        if (!isOver) setMade({ of, url: URL.createObjectURL(blob) })
      })
      .catch((error: unknown) => {
        if (!isOver) setMade({ of, error: explain(error) })
      })
    return () => {
      isOver = true
    }
  }, [grey, picture])
  useEffect(() => () => {
    release(made?.url)
  }, [made])
  // The colours of a former light stay until the new ones are made: they are the same. Those of another camera do not.
  const isCurrent = grey !== undefined && made?.of[0] === grey
  return { url: isCurrent ? made.url : undefined, error: isCurrent ? made.error : undefined }
}
