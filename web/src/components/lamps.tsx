import { useMemo, useState } from 'preact/hooks'
import { address, apiKey } from '../api/client'
import { explain, type PageError } from '../api/page-error'
import type { Environments, Lamp, MaterialEdit, Model } from '../api/types'
import { called } from '../format'
import { MOST_LAMPS, newLamp, SHAPES, shining, snapped, staged, type PlacedLamp, type Point, type Staging } from '../lamps'
import { curl, requestOf, type Look, type View } from '../look'
import { depthAt, projected, unprojected, type LookAt } from '../projection'
import { SerialQueue } from '../serial-queue'
import { useDepths, useStaged } from '../stage-pictures'
import { Choices, Failure, save } from './common'
import { GroundFields, LampFields } from './lamp-fields'
import { isInside, lookAtOf, Stage, type LampPoint } from './stage-picture'

/** Width and height of the picture, pixels. */
const SIZE: [number, number] = [640, 480]
const ASPECT = SIZE[0] / SIZE[1]
/** Where new lamps are in the picture, and their depth as a share of the distance of the camera. */
const PLACES: [number, number][] = [[0.78, 0.18], [0.22, 0.18], [0.78, 0.8], [0.22, 0.8]]
const NEAR = 0.75
/** Least distance of a new lamp from the others in the picture, as a share of its sides. */
const APART = 0.1
/** Depth of a lamp in front of a surface, as a share of the depth of the surface. */
const BEFORE = 0.8

type Change = (change: (before: Staging) => Staging) => void

interface LampsProps {
  model: Model
  look: Look
  view: View | undefined
  lights: Environments | undefined
  edits: MaterialEdit[]
  staging: Staging
  onChange: Change
}

/** Lamps and the ground of a model. Nothing is loaded before the panel is opened. */
export function Lamps(props: LampsProps) {
  const { staging, view, lights } = props
  const [isOpen, setOpen] = useState(staging.lamps.length > 0 || staging.floor !== undefined)
  const amount = shining(staging).length
  return (
    <section class="card stack lamps" aria-labelledby="lamps">
      <h2 id="lamps">Lamps and ground</h2>
      <p class="small muted">Put up to four lamps beside the light of the page, and the model on a ground that gets its shadow. The server draws the picture.</p>
      <div class="row">
        <button type="button" aria-expanded={isOpen} onClick={() => setOpen(!isOpen)}>{isOpen ? 'Hide the lamps' : 'Show the lamps'}</button>
        {!isOpen && amount > 0 ? <span class="small">{amount === 1 ? '1 lamp shines.' : `${amount} lamps shine.`}</span> : null}
      </div>
      {isOpen && view && lights ? <Editor {...props} view={view} lights={lights} /> : null}
    </section>
  )
}

/** The lamps with another value of one of them. */
function withLamp({ lamps, ...staging }: Staging, index: number, some: (before: PlacedLamp) => PlacedLamp): Staging {
  return { ...staging, lamps: lamps.map((one, i) => (i === index ? some(one) : one)) }
}

function Editor({ model, look, view, lights, edits, staging, onChange }: LampsProps & { view: View; lights: Environments }) {
  const [chosen, setChosen] = useState(0)
  const queue = useMemo(() => new SerialQueue(), [])
  const request = { ...requestOf({ ...look, output: 'rgb' }, view, lights.builtin, SIZE), ...(edits.length > 0 ? { materials: edits } : {}) }
  const picture = useStaged(model.id, request, staging, queue)
  const depths = useDepths(model.id, picture.request, queue)
  const lamp = staging.lamps[chosen]?.lamp
  const replace = (index: number, some: (before: Lamp) => Lamp) => onChange((before) => withLamp(before, index, (one) => ({ ...one, lamp: some(one.lamp) })))
  const add = (position: Point, target: Point) => {
    setChosen(staging.lamps.length)
    onChange((before) => ({ ...before, lamps: [...before.lamps, { lamp: newLamp(position, target), isOn: true }] }))
  }
  const move = (index: number, point: LampPoint, to: Point) => replace(index, (before) => ({ ...before, [point]: snapped(to, view.distance) }))
  const placing = usePlacing({ camera: lookAtOf(picture), depths, distance: view.distance, lamp, chosen, onMove: move, onAdd: add })
  const addNew = () => {
    const camera = request.camera.look_at as LookAt
    add(unprojected(camera, ASPECT, { at: freePlace(camera, staging.lamps), depth: NEAR * view.distance }), view.target)
  }
  const removed = (index: number) => {
    setChosen((before) => Math.max(0, index <= before ? before - 1 : before))
    onChange((before) => ({ ...before, lamps: before.lamps.filter((_, i) => i !== index) }))
  }
  return (
    <>
      <div class="halves">
        <div class="stack seen">
          <Stage picture={picture} size={SIZE} floor={staging.floor} lamps={staging.lamps} chosen={chosen} onChoose={setChosen} onPick={placing.pick} onMove={move} />
          {lamp?.target ? <Choices legend="A click in the picture moves" name="lamp-click" pills value={placing.point} of={[{ value: 'position', label: 'the lamp' }, { value: 'target', label: 'its target' }]} onChange={(point) => placing.setPoint(point as LampPoint)} /> : null}
          <div>
            <p class="hint">{hintFor(lamp, chosen + 1, lookAtOf(picture))}</p>
            <p class="small muted" role="status">{placing.told}</p>
            <Failure error={picture.error} retry={picture.retry} />
            <Failure error={placing.error} />
          </div>
        </div>
        <div class="stack">
          <LampList lamps={staging.lamps} chosen={chosen} onChoose={setChosen} onSwitch={(index, isOn) => onChange((before) => withLamp(before, index, (one) => ({ ...one, isOn })))} onRemove={removed} onAdd={addNew} />
          {lamp ? <LampFields key={chosen} lamp={lamp} number={chosen + 1} centre={view.target} scale={view.distance} onChange={(lamp) => replace(chosen, () => lamp)} /> : null}
          <label class="check"><input type="checkbox" checked={staging.isSharp} onChange={(event) => onChange((before) => ({ ...before, isSharp: event.currentTarget.checked }))} />Sharp shadows (slower)</label>
          <GroundFields staging={staging} scale={view.distance} onChange={(some) => onChange((before) => ({ ...before, ...some }))} />
        </div>
      </div>
      <div class="row">
        <button type="button" disabled={!picture.blob || Boolean(picture.waiting)} onClick={() => picture.blob && save(picture.blob, `${called(model, 'model').replace(/[^\w.-]+/g, '-')}-lamps.png`)}>Save this picture</button>
      </div>
      <Command command={curl(address(`v1/models/${model.id}/render`), staged(request, staging), Boolean(apiKey()))} isOnGround={staging.floor !== undefined} />
    </>
  )
}

/** How to place the chosen lamp in the picture. */
function hintFor(lamp: Lamp | undefined, number: number, camera: LookAt | undefined): string {
  if (!lamp) return 'Add a lamp, or click in the picture to put one there.'
  const seen = camera && projected(camera, ASPECT, lamp.position)
  const drag = !camera || (seen && isInside(seen)) ? 'Drag a number to move its lamp.' : `Lamp ${number} is outside the picture.`
  return `${drag} A click puts lamp ${number} in front of the surface there${lamp.target ? ', or points it there' : ''}.`
}

/** A place of the picture for a new lamp, where no other lamp is. */
function freePlace(camera: LookAt, lamps: PlacedLamp[]): [number, number] {
  const taken = lamps.map(({ lamp }) => projected(camera, ASPECT, lamp.position)?.at)
  const isFree = ([x, y]: [number, number]) => taken.every((at) => !at || Math.hypot(at[0] - x, at[1] - y) > APART)
  return PLACES.find(isFree) ?? [0.5, 0.1]
}

interface PlacingProps {
  camera: LookAt | undefined
  depths: ReturnType<typeof useDepths>
  distance: number
  lamp: Lamp | undefined
  chosen: number
  onMove: (index: number, point: LampPoint, to: Point) => void
  onAdd: (position: Point, target: Point) => void
}

/** Moves the chosen lamp or its target to a click in the picture; without lamps the click adds one. */
function usePlacing({ camera, depths, distance, lamp, chosen, onMove, onAdd }: PlacingProps) {
  const [wanted, setPoint] = useState<LampPoint>('position')
  const [told, setTold] = useState('')
  const [error, setError] = useState<PageError>()
  const point = lamp?.target ? wanted : 'position'
  const place = (at: [number, number], surface: number | undefined) => {
    if (!camera) return
    const depth = surface ?? distance
    const there = unprojected(camera, ASPECT, { at, depth })
    const before = unprojected(camera, ASPECT, { at, depth: BEFORE * depth })
    if (!lamp) onAdd(before, there)
    else onMove(chosen, point, point === 'target' ? there : before)
    const name = `Lamp ${lamp ? chosen + 1 : 1}`
    const done = point === 'target' ? `${name} faces this point.` : `${name} was placed.`
    setTold(surface === undefined ? `There is no surface at this point. ${done} Its depth is that of the middle of the view.` : done)
  }
  const pick = (at: [number, number]) => {
    setError(undefined)
    setTold('Looking for the surface at this point.')
    depths().then((map) => place(at, map && depthAt(map, at)), (failure: unknown) => {
      setTold('')
      setError(explain(failure))
    })
  }
  return { point, setPoint, told, error, pick }
}

interface LampListProps {
  lamps: PlacedLamp[]
  chosen: number
  onChoose: (index: number) => void
  onSwitch: (index: number, isOn: boolean) => void
  onRemove: (index: number) => void
  onAdd: () => void
}

/** The lamps: which one is edited, which ones shine. */
function LampList({ lamps, chosen, onChoose, onSwitch, onRemove, onAdd }: LampListProps) {
  const label = ({ lamp: { shape } }: PlacedLamp) => SHAPES.find(([name]) => name === shape)?.[1] ?? shape
  return (
    <fieldset>
      <legend>Lamps</legend>
      <div class="stack tight">
        {lamps.map((one, i) => (
          <div class="row lamp" key={i}>
            <label class="choice"><input type="radio" name="lamp" value={i} checked={i === chosen} onChange={() => onChoose(i)} /><b>{i + 1}</b> · {label(one)}</label>
            <label class="check"><input type="checkbox" aria-label={`Lamp ${i + 1} shines`} checked={one.isOn} onChange={(event) => onSwitch(i, event.currentTarget.checked)} />on</label>
            <button type="button" class="quiet" aria-label={`Remove lamp ${i + 1}`} onClick={() => onRemove(i)}>Remove</button>
          </div>
        ))}
        <div class="row">
          <button type="button" disabled={lamps.length >= MOST_LAMPS} onClick={onAdd}>Add a lamp</button>
          {lamps.length >= MOST_LAMPS ? <span class="hint">The page has at most {MOST_LAMPS} lamps, a request 16.</span> : null}
        </div>
      </div>
    </fieldset>
  )
}

/** The picture as a command. */
function Command({ command, isOnGround }: { command: string; isOnGround: boolean }) {
  return (
    <details>
      <summary>The request of this picture</summary>
      <div class="stack tight">
        <pre tabIndex={0} aria-label="Request of the picture with lamps">{command}</pre>
        {isOnGround ? <p class="hint">The request has the picture without the ground.</p> : null}
      </div>
    </details>
  )
}
