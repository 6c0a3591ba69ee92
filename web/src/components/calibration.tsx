import { useState } from 'preact/hooks'
import { put, remove } from '../api/client'
import { explain, type PageError } from '../api/page-error'
import type { Model, NewCalibration } from '../api/types'
import { Failure } from './common'
import { PatchPicker, type Patch } from './patch-picker'

/** Surfaces of known reflectance; the last one is entered. */
const SURFACES = [
  ['0.9', 'White paper (90 %)'],
  ['0.18', 'Grey card (18 %)'],
  ['own', 'Another known reflectance'],
] as const

/** Accepted reflectance. */
const DARKEST = 0.01
const BRIGHTEST = 1

/** Level and colour of a finished model from a surface of known reflectance in one of its photographs. */
export function Calibration({ model, onDone }: { model: Model; onDone: () => void }) {
  const [isOpen, setOpen] = useState(false)
  const [patch, setPatch] = useState<Patch>()
  const [surface, setSurface] = useState<string>('0.9')
  const [own, setOwn] = useState('')
  const [isBusy, setBusy] = useState(false)
  const [told, setTold] = useState('')
  const [error, setError] = useState<PageError>()
  const path = `v1/models/${encodeURIComponent(model.id)}/calibration`
  const run = (work: Promise<unknown>, done: string) => {
    setBusy(true)
    setError(undefined)
    setTold('')
    work.then(() => {
      setTold(done)
      onDone()
    }, (failure: unknown) => setError(explain(failure))).finally(() => setBusy(false))
  }
  const apply = () => {
    const reflectance = read(surface === 'own' ? own : surface)
    if (!patch) return setError({ what: 'No surface is chosen.', remedy: 'Click on it in the photograph.' })
    if (!reflectance) return setError({ what: 'The reflectance is one number or three numbers, each from 0.01 to 1.', remedy: 'Write for example 0.5, or 0.5, 0.3, 0.2 for red, green and blue.' })
    run(put<Model>(path, { patch, reflectance }), 'The model was calibrated.')
  }
  const { calibration } = model
  return (
    <section class="card stack" aria-labelledby="calibration">
      <h2 id="calibration">Calibrate colour</h2>
      <p class="small muted">Photographs alone do not show whether a surface is bright or its light is bright. Choose a surface whose reflectance you know, such as white paper or a grey card.</p>
      {calibration ? <p class="small">Calibrated to the reflectance {shown(calibration.reflectance)}. The albedo was multiplied by {shown(calibration.scale)}.</p> : null}
      {isOpen ? (
        <PatchPicker id="calibration" capture={model.capture} heldOut legend="Click on the surface or drag across it" value={patch} onChange={setPatch}>
          <div>
            <label for="calibration-surface">Surface</label>
            <select id="calibration-surface" value={surface} onChange={(event) => setSurface(event.currentTarget.value)}>
              {SURFACES.map(([value, label]) => <option key={value} value={value}>{label}</option>)}
            </select>
          </div>
          {surface === 'own' ? (
            <div>
              <label for="calibration-reflectance">Reflectance, or red, green, blue</label>
              <input id="calibration-reflectance" inputMode="decimal" placeholder="0.5, 0.3, 0.2" value={own} onInput={(event) => setOwn(event.currentTarget.value)} />
            </div>
          ) : null}
        </PatchPicker>
      ) : null}
      <div class="row">
        {isOpen ? <button type="button" disabled={isBusy} onClick={apply}>Apply</button> : <button type="button" onClick={() => setOpen(true)}>Choose a surface</button>}
        {calibration?.total_scale ? <button type="button" class="quiet" disabled={isBusy} onClick={() => run(remove(path), 'The calibration was undone.')}>Undo</button> : null}
        {isBusy ? <span class="spinner" /> : null}
      </div>
      <p class="small muted" role="status">{told}</p>
      <Failure error={error} />
    </section>
  )
}

/** One number or three; undefined for other texts. */
function read(text: string): NewCalibration['reflectance'] | undefined {
  const numbers = text.split(/[\s,;]+/).filter(Boolean).map(Number)
  const areKnown = numbers.every((value) => value >= DARKEST && value <= BRIGHTEST)
  const [grey] = numbers
  if (!areKnown || grey === undefined) return undefined
  if (numbers.length === 3) return numbers
  return numbers.length === 1 ? grey : undefined
}

function shown(rgb: number[]): string {
  return rgb.map((value) => value.toFixed(2)).join(', ')
}
