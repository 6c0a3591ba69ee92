import { useRef } from 'preact/hooks'
import type { PlacedLamp, Point } from '../lamps'
import { projected, unprojected, type LookAt, type Seen } from '../projection'
import type { StagedPicture } from '../stage-pictures'

/** Shares of the picture per arrow key, and the factor of the depth per Page Up. */
const STEP = 0.02
const FARTHER = 1.05

/** A point of a lamp that the picture shows. */
export type LampPoint = 'position' | 'target'

interface StageProps {
  picture: StagedPicture
  size: [number, number]
  /** Colour behind the picture. */
  floor: string | undefined
  lamps: PlacedLamp[]
  chosen: number
  onChoose: (index: number) => void
  onPick: (at: [number, number]) => void
  onMove: (index: number, point: LampPoint, to: Point) => void
}

/** The camera of a picture, if the picture looks at a point. */
export function lookAtOf(picture: Pick<StagedPicture, 'request'>): LookAt | undefined {
  return picture.request && 'look_at' in picture.request.camera ? (picture.request.camera.look_at as LookAt) : undefined
}

/** The picture with a handle for each lamp in it. */
export function Stage({ picture, size, floor, lamps, chosen, onChoose, onPick, onMove }: StageProps) {
  const stage = useRef<HTMLDivElement>(null)
  const camera = lookAtOf(picture)
  const aspect = size[0] / size[1]
  const at = (event: MouseEvent): [number, number] => {
    const box = stage.current!.getBoundingClientRect()
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height]
  }
  const handleOf = (index: number, point: LampPoint) => {
    const place = lamps[index]?.lamp[point]
    const seen = camera && place ? projected(camera, aspect, place) : undefined
    if (!camera || !seen || !isInside(seen)) return null
    const name = point === 'position' ? `Lamp ${index + 1}` : `Target of lamp ${index + 1}`
    const text = point === 'position' ? String(index + 1) : ''
    const move = (to: Seen) => onMove(index, point, unprojected(camera, aspect, to))
    return <Handle key={`${point} ${index}`} name={name} text={text} kind={point} isChosen={index === chosen} isOff={!lamps[index]?.isOn} seen={seen} at={at} onChoose={() => onChoose(index)} onMove={move} />
  }
  return (
    <div class="edited stage" ref={stage} style={{ aspectRatio: `${size[0]} / ${size[1]}`, ...(floor ? { background: floor } : {}) }}>
      {picture.url ? <img src={picture.url} alt="The model with the lamps" draggable={false} onClick={(event) => onPick(at(event))} /> : null}
      {camera ? <Beam lamp={lamps[chosen]} camera={camera} aspect={aspect} /> : null}
      {handleOf(chosen, 'target')}
      {lamps.map((_, index) => handleOf(index, 'position'))}
      {picture.waiting ? <p class="late"><span class="spinner" />{picture.waiting === 'ground' ? 'The ground is on its way' : 'The picture is on its way'}</p> : null}
    </div>
  )
}

/** Whether a place is in the picture. */
export function isInside({ at }: Seen): boolean {
  return at.every((share) => share >= 0 && share <= 1)
}

const percent = (share: number | undefined) => `${100 * (share ?? 0)}%`

/** The line from a lamp to the point that it faces. */
function Beam({ lamp, camera, aspect }: { lamp: PlacedLamp | undefined; camera: LookAt; aspect: number }) {
  if (!lamp?.lamp.target) return null
  const [from, to] = [lamp.lamp.position, lamp.lamp.target].map((point) => projected(camera, aspect, point)?.at)
  if (!from || !to) return null
  const ends = { x1: percent(from[0]), y1: percent(from[1]), x2: percent(to[0]), y2: percent(to[1]) }
  return <svg class="beam" aria-hidden="true"><line {...ends} class="under" /><line {...ends} /></svg>
}

interface HandleProps {
  name: string
  text: string
  kind: LampPoint
  isChosen: boolean
  isOff: boolean
  seen: Seen
  at: (event: MouseEvent) => [number, number]
  onChoose: () => void
  onMove: (to: Seen) => void
}

/** A point of a lamp: drag it, or move it with the keys. */
function Handle({ name, text, kind, isChosen, isOff, seen, at, onChoose, onMove }: HandleProps) {
  /** Where the pointer took the handle, from its middle. */
  const taken = useRef<[number, number]>([0, 0])
  const key = (event: KeyboardEvent) => {
    const [x, y] = seen.at
    const to = ({
      ArrowLeft: { at: [x - STEP, y], depth: seen.depth },
      ArrowRight: { at: [x + STEP, y], depth: seen.depth },
      ArrowUp: { at: [x, y - STEP], depth: seen.depth },
      ArrowDown: { at: [x, y + STEP], depth: seen.depth },
      PageUp: { at: [x, y], depth: seen.depth * FARTHER },
      PageDown: { at: [x, y], depth: seen.depth / FARTHER },
    } satisfies Record<string, Seen>)[event.key]
    if (!to) return
    event.preventDefault()
    onMove(inside(to))
  }
  return (
    <button
      type="button"
      class={`handle ${kind}${isChosen ? ' chosen' : ''}${isOff ? ' off' : ''}`}
      style={{ left: percent(seen.at[0]), top: percent(seen.at[1]) }}
      aria-label={name}
      title={`${name}: drag, or use the arrow keys, Page Up and Page Down`}
      onClick={onChoose}
      onKeyDown={key}
      onPointerDown={(event) => {
        const [x, y] = at(event)
        taken.current = [x - seen.at[0], y - seen.at[1]]
        event.currentTarget.setPointerCapture(event.pointerId)
        onChoose()
      }}
      onPointerMove={(event) => {
        if (!event.currentTarget.hasPointerCapture(event.pointerId)) return
        const [x, y] = at(event)
        onMove(inside({ at: [x - taken.current[0], y - taken.current[1]], depth: seen.depth }))
      }}
    >
      {text}
    </button>
  )
}

function inside({ at: [x, y], depth }: Seen): Seen {
  const within = (share: number) => Math.min(1, Math.max(0, share))
  return { at: [within(x), within(y)], depth }
}
