import { useState } from 'preact/hooks'
import { message, post } from '../api/client'
import type { Capture, Job, Listed, NewJob } from '../api/types'
import { Badge, Choices, Failure, Head } from '../components/common'
import { called, count, decibels, moment } from '../format'
import { useLoaded, useTitle } from '../hooks'
import { go, link } from '../router'

/** Interval between two requests for the list, milliseconds. */
const POLL = 3000

const PRESETS = [
  { value: 'draft', label: 'Draft', hint: 'a look: minutes on a CPU' },
  { value: 'standard', label: 'Standard', hint: '40,000 Gaussians, 400 px' },
  { value: 'high', label: 'High', hint: '80,000 Gaussians, 800 px' },
]

export function JobsPage({ capture }: { capture: string | null }) {
  useTitle('Jobs')
  const jobs = useLoaded<Listed<Job>>('v1/jobs?limit=100', POLL)
  const captures = useLoaded<Listed<Capture>>('v1/captures?limit=200')
  const ready = captures.data?.items.filter((one) => (one.state ?? 'ready') === 'ready')
  return (
    <>
      <Head title="Jobs" note="Trainings: one runs, the others wait." />
      <div class="stack">
        {ready?.length ? <NewTraining captures={ready} chosen={capture} /> : ready ? <p class="card empty">A training needs a capture. <a href={link(['captures'])}>Add one</a> first.</p> : null}
        <Failure error={jobs.error} />
        {jobs.data?.items.length ? <Table of={jobs.data.items} captures={captures.data?.items ?? []} /> : null}
      </div>
    </>
  )
}

function NewTraining({ captures, chosen }: { captures: Capture[]; chosen: string | null }) {
  const [capture, setCapture] = useState(chosen ?? captures[0]?.id ?? '')
  const [preset, setPreset] = useState('draft')
  const [error, setError] = useState<string>()
  const start = (event: SubmitEvent) => {
    event.preventDefault()
    const form = new FormData(event.currentTarget as HTMLFormElement)
    const text = (name: string) => String(form.get(name) ?? '').trim()
    const overrides: Record<string, number> = {}
    for (const name of ['iterations', 'resolution', 'max_gaussians']) if (text(name)) overrides[name] = Number(text(name))
    const job: Record<string, unknown> = { capture, preset, overrides }
    if (text('name')) job.name = text('name')
    if (text('gate')) job.quality_gate = { 'novel_view.psnr': `>=${text('gate')}` }
    post<Job>('v1/jobs', job as unknown as NewJob, { 'Idempotency-Key': crypto.randomUUID?.() ?? String(Math.random()) })
      .then((made) => go(link(['jobs', made.id])), (failure: unknown) => setError(message(failure)))
  }
  return (
    <form class="card stack" onSubmit={start} aria-labelledby="new-training">
      <h2 id="new-training">New training</h2>
      <Choices legend="Preset" name="preset" value={preset} of={PRESETS} onChange={setPreset} />
      <div class="fields">
        <div>
          <label for="capture">Capture</label>
          <select id="capture" value={capture} onChange={(event) => setCapture(event.currentTarget.value)}>
            {captures.map((one) => <option key={one.id} value={one.id}>{called(one, 'Capture')}</option>)}
          </select>
        </div>
        <div><label for="name">Name <span class="hint">(optional)</span></label><input id="name" name="name" maxLength={200} autocomplete="off" /></div>
        <div><label for="gate">Quality gate, dB <span class="hint">(optional)</span></label><input id="gate" name="gate" type="number" min="0" max="60" step="0.1" placeholder="e.g. 28" aria-describedby="gate-hint" /></div>
      </div>
      <p class="hint" id="gate-hint">A model whose held-out views reach less PSNR than the gate is kept, and its job ends as rejected.</p>
      <details>
        <summary>Settings</summary>
        <div class="fields">
          <div><label for="iterations">Steps</label><input id="iterations" name="iterations" type="number" min="1" step="1" placeholder="as the preset" /></div>
          <div><label for="resolution">Longest side, px</label><input id="resolution" name="resolution" type="number" min="16" step="1" placeholder="as the preset" /></div>
          <div><label for="max_gaussians">Gaussians at most</label><input id="max_gaussians" name="max_gaussians" type="number" min="1" step="1" placeholder="as the preset" /></div>
        </div>
      </details>
      <Failure error={error} />
      <div class="row"><button class="primary" type="submit">Start training</button></div>
    </form>
  )
}

function Table({ of: jobs, captures }: { of: Job[]; captures: Capture[] }) {
  const [chosen, setChosen] = useState<string[]>([])
  const [a, b] = chosen
  const choose = (id: string, on: boolean) => setChosen((before) => (on ? [...before, id].slice(-2) : before.filter((one) => one !== id)))
  const captureOf = (job: Job) => captures.find((one) => one.id === job.capture)
  return (
    <section class="card" aria-labelledby="all-jobs">
      <div class="row">
        <h2 id="all-jobs" style={{ flex: '1' }}>All jobs</h2>
        {a && b ? <a class="button primary" href={link(['compare'], { a, b })}>Compare the two</a> : <span class="hint">Tick two to compare them</span>}
      </div>
      <div class="scroll">
        <table>
          <thead><tr><th>Compare</th><th>Name</th><th>State</th><th>Progress</th><th>Preset</th><th class="number">Held-out PSNR</th><th class="number">Gaussians</th><th>Added</th></tr></thead>
          <tbody>
            {jobs.map((job) => {
              const capture = captureOf(job)
              const name = job.name ?? (capture ? `${called(capture, 'Capture')}, ${job.preset}` : called(job, 'Job'))
              return (
                <tr key={job.id}>
                  <td><input type="checkbox" aria-label={`Compare ${name}`} checked={chosen.includes(job.id)} onChange={(event) => choose(job.id, event.currentTarget.checked)} /></td>
                  <td><a href={link(['jobs', job.id])}>{name}</a></td>
                  <td><Badge state={job.state} /></td>
                  <td>{job.state === 'running' ? <progress aria-label={`Progress of ${name}`} value={job.progress.step} max={job.progress.total} /> : `${count(job.progress.step)} / ${count(job.progress.total)}`}</td>
                  <td>{job.preset}</td>
                  <td class="number">{decibels(job.figures?.novel_view?.psnr)}</td>
                  <td class="number">{count(job.progress.gaussians)}</td>
                  <td class="muted">{moment(job.created_at)}</td>
                </tr>
              )
            })}
          </tbody>
        </table>
      </div>
    </section>
  )
}
