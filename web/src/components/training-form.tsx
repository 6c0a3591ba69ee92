import { useState } from 'preact/hooks'
import { post } from '../api/client'
import { explain, type PageError } from '../api/page-error'
import type { Capture, GreyCard, Job, NewJob } from '../api/types'
import { called, count, spoken } from '../format'
import { go, link } from '../router'
import { Choices, Failure } from './common'
import { GreyCardPatch } from './grey-card'

/** Time budgets in seconds, and the choice of a preset instead. */
const TIMES = [
  { value: '120', label: '2 minutes', hint: 'a first look' },
  { value: '600', label: '10 minutes', hint: 'for the web' },
  { value: '1800', label: '30 minutes', hint: 'more detail' },
  { value: '7200', label: '2 hours', hint: 'most detail' },
  { value: 'preset', label: 'A preset', hint: 'for experts' },
]

const PRESETS = [
  { value: 'draft', label: 'Draft', hint: '8,000 Gaussians, 160 px' },
  { value: 'standard', label: 'Standard', hint: '40,000 Gaussians, 400 px' },
  { value: 'high', label: 'High', hint: '80,000 Gaussians, 800 px' },
]

/** The light of the photographs, as a photographer names it. Numbers are kelvin. */
const BALANCES = [
  ['', 'Find out from the photographs'],
  ['daylight', 'Daylight'],
  ['neutral', 'White is already white in them'],
  ['2900', 'Warm lamps (2900 K)'],
  ['4000', 'Neutral lamps (4000 K)'],
  ['7500', 'Shade or clouds (7500 K)'],
  ['card', 'A grey card or white paper shows it'],
] as const

/** Queues a training of a capture. */
export function NewTraining({ captures, chosen, jobs }: { captures: Capture[]; chosen: string | null; jobs: Job[] }) {
  const [capture, setCapture] = useState(chosen ?? captures[0]?.id ?? '')
  const [time, setTime] = useState('120')
  const [preset, setPreset] = useState('draft')
  const [balance, setBalance] = useState('')
  const [card, setCard] = useState<GreyCard>()
  const [error, setError] = useState<PageError>()
  const isPreset = time === 'preset'
  const hasMasks = captures.find((one) => one.id === capture)?.report.has_alpha ?? false
  const start = (event: SubmitEvent) => {
    event.preventDefault()
    if (balance === 'card' && !card) return setError({ what: 'No grey or white surface is chosen.', remedy: 'Click on it in the photograph, or choose another light.' })
    const job = requested(new FormData(event.currentTarget as HTMLFormElement), { capture, time, preset, card: balance === 'card' ? card : undefined })
    post<Job>('v1/jobs', job, { 'Idempotency-Key': crypto.randomUUID?.() ?? String(Math.random()) })
      .then((made) => go(link(['jobs', made.id])), (failure: unknown) => setError(explain(failure)))
  }
  return (
    <form class="card stack" onSubmit={start} aria-labelledby="new-training">
      <h2 id="new-training">New training</h2>
      <Choices legend="How long may it take?" name="time" value={time} of={TIMES} onChange={setTime} />
      {isPreset ? <Choices legend="Preset" name="preset" value={preset} of={PRESETS} onChange={setPreset} /> : null}
      <div class="fields">
        <div>
          <label for="capture">Photographs</label>
          <select id="capture" value={capture} onChange={(event) => {
            setCapture(event.currentTarget.value)
            setCard(undefined)
          }}>
            {captures.map((one) => <option key={one.id} value={one.id}>{called(one, 'Capture')}</option>)}
          </select>
        </div>
        <div>
          <label for="crop">What becomes the model</label>
          <select id="crop" name="crop" disabled={hasMasks} aria-describedby={hasMasks ? 'masked' : undefined}>
            <option value="">Everything that is visible</option>
            <option value="auto">Only the thing in the middle</option>
          </select>
          {hasMasks ? <span class="hint" id="masked">The background is already masked out.</span> : null}
        </div>
        <div>
          <label for="balance">Light of the photographs</label>
          <select id="balance" name="white_balance" value={balance} onChange={(event) => setBalance(event.currentTarget.value)}>{BALANCES.map(([value, label]) => <option key={value} value={value}>{label}</option>)}</select>
        </div>
        <div><label for="name">Name <span class="hint">(optional)</span></label><input id="name" name="name" maxLength={200} autocomplete="off" /></div>
      </div>
      {balance === 'card' ? <GreyCardPatch key={capture} capture={capture} value={card} onChange={setCard} /> : null}
      <Details isPreset={isPreset} />
      <Failure error={error} />
      <div class="row"><button class="primary" type="submit">Start training</button><Forecast jobs={jobs} time={time} preset={preset} /></div>
    </form>
  )
}

/** Settings for experts. */
function Details({ isPreset }: { isPreset: boolean }) {
  return (
    <details>
      <summary>Details</summary>
      <div class="stack">
        <div class="fields">
          {isPreset ? <Whole name="iterations" label="Steps" min={1} /> : null}
          <Whole name="resolution" label="Longest side, px" min={16} />
          <Whole name="max_gaussians" label="Gaussians at most" min={16} />
          <div><label for="gate">Quality gate, dB <span class="hint">(optional)</span></label><input id="gate" name="gate" type="number" min="0" max="60" step="0.1" placeholder="e.g. 28" aria-describedby="gate-hint" /></div>
        </div>
        <p class="hint" id="gate-hint">If photographs that the training did not see have less PSNR than the gate, the model is kept and the job ends as rejected.</p>
        <div><label for="light_groups">Photographs under several lights <span class="hint">(optional)</span></label><input id="light_groups" name="light_groups" placeholder="noon=IMG_1*, evening=IMG_2*" autocomplete="off" aria-describedby="lights-hint" /></div>
        <p class="hint" id="lights-hint">For each light: a name, and the names of its photographs. * stands for any characters. The object must not move between the photographs.</p>
      </div>
    </details>
  )
}

function Whole({ name, label, min }: { name: string; label: string; min: number }) {
  return <div><label for={name}>{label}</label><input id={name} name={name} type="number" min={min} step="1" placeholder="automatic" /></div>
}

/** The body of the request. */
function requested(form: FormData, { capture, time, preset, card }: { capture: string; time: string; preset: string; card: GreyCard | undefined }): NewJob {
  const text = (name: string) => String(form.get(name) ?? '').trim()
  const overrides: Record<string, unknown> = {}
  for (const name of ['iterations', 'resolution', 'max_gaussians']) if (text(name)) overrides[name] = Number(text(name))
  if (time !== 'preset') overrides.time_budget_s = Number(time)
  if (text('crop')) overrides.crop = text('crop')
  if (text('light_groups')) overrides.light_groups = lightGroups(text('light_groups'))
  const balance = text('white_balance')
  if (card) overrides.grey_card = card
  else if (balance) overrides.white_balance = Number(balance) || balance
  const job: Record<string, unknown> = { capture, overrides }
  if (time === 'preset') job.preset = preset
  if (text('name')) job.name = text('name')
  if (text('gate')) job.quality_gate = { 'novel_view.psnr': `>=${text('gate')}` }
  return job as unknown as NewJob
}

/** The pattern of file names by the name of the light, from `name=pattern, ...`. The server refuses what is not complete. */
function lightGroups(text: string): Record<string, string> {
  const pair = (part: string): [string, string] => {
    const [name = '', ...pattern] = part.split('=')
    return [name.trim(), pattern.join('=').trim()]
  }
  return Object.fromEntries(text.split(',').filter((part) => part.trim()).map(pair))
}

/** How long the training takes and what runs before it. */
function Forecast({ jobs, time, preset }: { jobs: Job[]; time: string; preset: string }) {
  const running = jobs.filter(({ state }) => state === 'running')
  const before = running.length + jobs.filter(({ state }) => state === 'queued').length
  const left = Math.max(0, ...running.map(({ progress }) => progress.eta_seconds ?? 0))
  const last = jobs.find((job) => job.state === 'succeeded' && job.preset === preset && !job.overrides.time_budget_s && job.started_at && job.finished_at)
  const took = last ? (Date.parse(last.finished_at ?? '') - Date.parse(last.started_at ?? '')) / 1000 : undefined
  const takes = time !== 'preset' ? `It takes ${spoken(Number(time))}.` : took ? `The last training with this preset took ${spoken(took)}.` : 'No training with this preset has ended here yet.'
  const waits = before ? ` ${before === 1 ? 'One training is' : `${count(before)} trainings are`} before it${left ? `, the running one for about ${spoken(left)} more` : ''}.` : ''
  return <span class="hint" role="status">{takes}{waits}</span>
}
