import { useEffect, useState } from 'preact/hooks'
import { post, Refused } from '../api/client'
import { explain, type PageError } from '../api/page-error'
import type { Model, NextPhotograph, NextPhotographs } from '../api/types'
import { useSeen } from '../hooks'
import type { View } from '../look'
import { isAt, PLACES, placesFile, positionOf, spokenDirection, thumbnailOf } from '../next-photographs'
import { distanceOf, projected, type LookAt } from '../projection'
import { recorded } from '../viewer/photographed'
import { Failure, Picture, save } from './common'
import { isInside } from './stage-picture'

/** Turns the view to a direction (degrees), at the distance of the first view or at another one (capture units). */
export type Turn = (azimuth: number, elevation: number, distance?: number) => void

/** Share of half the sides of a picture within which all cameras are. */
const WITHIN = 0.9

/** The places for further photographs, as far as they have arrived. */
export interface Places {
  answer: NextPhotographs | undefined
  error: PageError | undefined
  /** Asks again. Undefined if the model has no places. */
  retry: (() => void) | undefined
}

/** Asks the server for the places when they are needed for the first time. */
export function usePlaces(model: string, isNeeded: boolean): Places {
  const [answer, setAnswer] = useState<NextPhotographs>()
  const [failed, setFailed] = useState<{ error: PageError; isFinal: boolean }>()
  const [round, setRound] = useState(0)
  const isMissing = isNeeded && !answer
  useEffect(() => {
    if (!isMissing) return
    let isOver = false
    setFailed(undefined)
    post<NextPhotographs>(`v1/models/${encodeURIComponent(model)}/next-photographs`, { count: PLACES }).then(
      (answer) => {
        if (!isOver) setAnswer(answer)
      },
      (error: unknown) => {
        if (!isOver) setFailed({ error: explain(error), isFinal: error instanceof Refused && error.status === 409 })
      },
    )
    return () => {
      isOver = true
    }
  }, [model, isMissing, round])
  return { answer, error: failed?.error, retry: failed?.isFinal ? undefined : () => setRound((n) => n + 1) }
}

/** The cameras of the places that a picture shows, as marks with their numbers. */
export function CameraMarks({ places, camera, aspect, onTurn }: { places: NextPhotograph[]; camera: LookAt; aspect: number; onTurn: Turn }) {
  const middle = Math.hypot(...camera.eye.map((value, k) => value - camera.target[k]!))
  const marks = places.flatMap((place, index) => {
    const position = positionOf(place)
    const seen = position && projected(camera, aspect, position)
    return seen && isInside(seen) ? [{ place, number: index + 1, seen }] : []
  })
  return (
    <>
      {marks.map(({ place, number, seen }) => (
        <button
          type="button"
          class={`camera-mark${seen.depth > middle ? ' behind' : ''}`}
          key={number}
          style={{ left: `${100 * seen.at[0]}%`, top: `${100 * seen.at[1]}%`, zIndex: places.length - number + 1 }}
          aria-label={`Camera ${number}: ${spokenDirection(place)}`}
          title={spokenDirection(place)}
          onClick={() => onTurn(place.azimuth_deg, place.elevation_deg)}
        >
          {number}
        </button>
      ))}
    </>
  )
}

interface PlaceListProps {
  model: Model
  places: Places
  view: View
  /** Width by height of the picture with the marks. */
  aspect: number
  onTurn: Turn
}

/** The places for further photographs: their directions, what the model shows there, and a file of their cameras. */
export function PlaceList({ model, places: { answer, error, retry }, view, aspect, onTurn }: PlaceListProps) {
  const first = firstPhotograph(model)
  return (
    <div class="stack tight">
      <h3 id="places">Where to photograph next</h3>
      <div>
        <p class="small muted" role="status">{answer || error ? null : <span class="row"><span class="spinner" />The server looks for the places</span>}</p>
        <Failure error={error} {...(retry ? { retry } : {})} />
        {answer ? <p class="small muted">The first place helps most. Left and right are as seen from the first photograph{first ? <> (<span class="name">{first}</span>)</> : null}. Up and down are angles from the horizon.</p> : null}
      </div>
      {answer ? (
        <>
          <ol class="places" aria-labelledby="places">
            {answer.cameras.map((place, index) => <Row key={place.candidate} model={model.id} place={place} number={index + 1} view={view} onTurn={onTurn} />)}
          </ol>
          <div class="row">
            <button type="button" onClick={() => onTurn(view.azimuth, view.elevation, overview(model, answer.cameras, view, aspect))}>Show all cameras</button>
            <button type="button" onClick={() => save(new Blob([placesFile(answer)], { type: 'application/json' }), 'next-photographs.json')}>↓ next-photographs.json</button>
          </div>
          <p class="hint">A click on a place, or on its number in the picture, turns the view there. Cameras with a dashed frame are farther away than the middle of the view. The file is a camera path for exports and for <code>relume render --path</code>.</p>
        </>
      ) : null}
    </div>
  )
}

/** One place. Its picture is loaded when it comes into view. */
function Row({ model, place, number, view, onTurn }: { model: string; place: NextPhotograph; number: number; view: View; onTurn: Turn }) {
  const [element, isSeen] = useSeen<HTMLLIElement>()
  return (
    <li ref={element}>
      <button type="button" aria-current={isAt(place, view)} onClick={() => onTurn(place.azimuth_deg, place.elevation_deg)}>
        <span class="thumb"><Picture path={isSeen ? thumbnailOf(model, place) : undefined} alt="" /></span>
        <span><b>{number}</b> · {spokenDirection(place)}</span>
      </button>
    </li>
  )
}

/** The distance of the view from which the picture has the cameras of all places. */
function overview({ card }: Model, places: NextPhotograph[], view: View, aspect: number): number {
  const target = recorded(card)?.target ?? view.target
  const eye = target.map((value, k) => value + view.eye[k]! - view.target[k]!)
  return distanceOf({ eye, target, fov_y_deg: view.fov }, aspect, places.map(positionOf).filter((at) => at !== undefined), WITHIN)
}

/** The name of the photograph from which azimuths are counted. Cards of large captures list a part of the photographs. */
function firstPhotograph({ card }: Model): string | undefined {
  const views = recorded(card)
  const first = views?.photographs[0]
  return first && first.azimuth_deg === views.azimuth_deg ? first.name : undefined
}
