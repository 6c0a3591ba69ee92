import { useEffect, useState } from 'preact/hooks'
import { address, apiKey, post, remove } from '../api/client'
import { explain, type PageError } from '../api/page-error'
import type { Environments, EnvironmentSpec, Export, Listed, MaterialEdit, SignedUrl } from '../api/types'
import { bytes, called, spoken } from '../format'
import { useLoaded } from '../hooks'
import { exportStaged, shining, type Staging } from '../lamps'
import { environment, exportDelight, exportName, exportOf, exportWithin, hasGaussians, TAKEN, type DelightFormat, type Look, type View } from '../look'
import { exportWith, isLitByChanges } from '../materials'
import { Badge, Failure } from './common'
import { DelightFields } from './delight-fields'
import { NumberField } from './number-field'

type Taken = keyof typeof TAKEN

/** Interval between two requests for an unfinished export, milliseconds. */
const EVERY = 1500

interface TakeAlongProps {
  model: string
  look: Look
  view: View | undefined
  lights: Environments | undefined
  edits: MaterialEdit[]
  staging: Staging
}

/** Requests exports of a model and lists the existing ones. */
export function TakeAlong({ model, look, view, lights, edits, staging }: TakeAlongProps) {
  const [what, setWhat] = useState<Taken>('frames')
  const [frames, setFrames] = useState(60)
  const [side, setSide] = useState(512)
  const [most, setMost] = useState<number>()
  const [format, setFormat] = useState<DelightFormat>('exr')
  const [longest, setLongest] = useState<number>()
  const [error, setError] = useState<PageError>()
  const [isMaking, setMaking] = useState(false)
  const made = useLoaded<Listed<Export>>(`v1/exports?limit=8&model=${encodeURIComponent(model)}`, isMaking ? EVERY : undefined)
  const exports = made.data?.items ?? []
  const isBusy = exports.some(({ state }) => state === 'queued' || state === 'running')
  useEffect(() => setMaking(isBusy), [isBusy])
  const act = (work: Promise<unknown>) => work.then(() => {
    setError(undefined)
    made.reload()
  }, (failure: unknown) => setError(explain(failure)))
  const start = (event: Event) => {
    event.preventDefault()
    const builtin = lights?.builtin ?? []
    const request = exportStaged(exportWith(exportOf(what, look, view, builtin, frames, side), edits, environment(look, builtin)), staging)
    void act(post<Export>(`v1/models/${encodeURIComponent(model)}/exports`, exportDelight(exportWithin(request, most), format, longest)))
  }
  const isTurntable = what === 'frames' || what === 'video' || what === 'layers'
  const lamps = shining(staging).length
  return (
    <section class="card stack" aria-labelledby="take">
      <h2 id="take">Take it along</h2>
      <form class="stack" onSubmit={start}>
        <div>
          <label for="take-what">What</label>
          <select id="take-what" value={what} onChange={(event) => setWhat(event.currentTarget.value as Taken)}>
            {Object.entries(TAKEN).map(([value, label]) => <option value={value} key={value}>{label}</option>)}
          </select>
        </div>
        {isTurntable ? (
          <div class="fields">
            <Whole id="take-frames" label="Frames" value={frames} least={1} most={10_000} onInput={setFrames} />
            <Whole id="take-side" label="Side, px" value={side} least={2} most={4096} onInput={setSide} />
          </div>
        ) : null}
        {hasGaussians(what) ? (
          <div>
            <NumberField id="take-most" label="Gaussians at most (optional)" value={most} step={1} least={1} empty="all" onInput={setMost} />
            <p class="hint">The file has those that contribute most to views around the model.</p>
          </div>
        ) : null}
        {what === 'delight' ? <DelightFields format={format} side={longest} onFormat={setFormat} onSide={setLongest} /> : null}
        {edits.length > 0 ? <p class="small">{changesIn(what, edits.length)}</p> : null}
        {lamps > 0 ? <p class="small">{isTurntable ? `The pictures have the light of ${lamps === 1 ? '1 lamp' : `${lamps} lamps`}.` : 'This file has no lamps; turntables have them.'}</p> : null}
        {what === 'layers' ? <p class="small">Each EXR has the picture, its depth, and the <code>shadow</code>, <code>bounce</code> and <code>contact</code> of the ground{staging.height === undefined ? ' at the lowest visible point of the model' : ` at the height ${staging.height}`}{lamps > 0 ? <>, and the <code>lamp_light</code> and <code>lamp_shadow</code> of the lamps</> : null}.</p> : null}
        <div class="row"><button type="submit">Make it</button></div>
      </form>
      <Failure error={error ?? made.error} />
      {exports.length > 0 ? <ul class="notices" aria-label="Made of this model">{exports.map((one) => <Made of={one} key={one.id} lights={lights} onAct={act} />)}</ul> : null}
    </section>
  )
}

/** Whether a file has the changes of materials. */
function changesIn(what: Taken, amount: number): string {
  if (what === 'delight') return 'This file has the photographed materials without changes.'
  return `The file has the changes of ${amount === 1 ? '1 material' : `${amount} materials`}${isLitByChanges(what) ? ', under the chosen light' : ''}.`
}

function Whole({ id, label, value, least, most, onInput }: { id: string; label: string; value: number; least: number; most: number; onInput: (value: number) => void }) {
  return (
    <div>
      <label for={id}>{label}</label>
      <input id={id} type="number" required min={least} max={most} step={1} value={value} onInput={(event) => onInput(Number(event.currentTarget.value))} />
    </div>
  )
}

/** The name of the light in a request. */
function nameOfLight(light: EnvironmentSpec | null | undefined, lights: Environments | undefined): string {
  const uploaded = lights?.items.find(({ id }) => id === light?.id)
  const name = uploaded ? called(uploaded, 'Light') : light?.id ? 'an uploaded light' : light?.builtin && light.builtin !== 'recovered' ? light.builtin : 'captured light'
  return light?.rotation_deg ? `${name} turned by ${Math.round(light.rotation_deg)}°` : name
}

/** How long an export still takes, from the frames that it has made. */
function timeLeft({ started_at, progress: { done, total } }: Export): string {
  const passed = started_at ? (Date.now() - Date.parse(started_at)) / 1000 : 0
  return done > 0 && total > 1 ? `about ${spoken((passed / done) * (total - done))} left` : 'some seconds'
}

/** One export: its progress or its file. */
function Made({ of, lights, onAct }: { of: Export; lights: Environments | undefined; onAct: (work: Promise<unknown>) => void }) {
  const { id, state, progress, file, error } = of
  const name = exportName(of, (light) => nameOfLight(light, lights))
  const isOver = state !== 'queued' && state !== 'running'
  return (
    <li class="stack">
      <div class="row">
        {file ? <button type="button" onClick={() => onAct(download(file.href))}>↓ {name}</button> : <span>{name}</span>}
        {file ? <span class="muted small">{bytes(file.bytes)}</span> : <Badge state={state} />}
        <button type="button" class="quiet" aria-label={`${isOver ? 'Delete' : 'Cancel'} ${name}`} onClick={() => onAct(remove(`v1/exports/${id}`))}>{isOver ? 'Delete' : 'Cancel'}</button>
      </div>
      {state === 'running' ? <><progress aria-label={`${name}: ${progress.done} of ${progress.total}`} value={progress.done} max={progress.total} /><span class="hint">{timeLeft(of)}</span></> : null}
      {error ? <Failure error={{ what: 'The export failed.', remedy: 'Delete it and make it again.', detail: error.detail }} /> : null}
    </li>
  )
}

/** Starts a browser download, which can be large. With an API key it uses a signed URL that is valid for one minute. */
async function download(path: string): Promise<void> {
  const url = apiKey() ? (await post<SignedUrl>('v1/signed-urls', { path, expires_in: 60 })).url : path
  Object.assign(document.createElement('a'), { href: address(url), download: '' }).click()
}
