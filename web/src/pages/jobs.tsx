import { useState } from 'preact/hooks'
import type { Capture, Job, Listed } from '../api/types'
import { Badge, Failure, Head, Picture } from '../components/common'
import { NewTraining } from '../components/training-form'
import { called, moment, planOf, spoken } from '../format'
import { useLoaded, useTitle } from '../hooks'
import { link } from '../router'

/** Interval between two requests for the list, milliseconds. */
const POLL = 3000

export function JobsPage({ capture }: { capture: string | null }) {
  useTitle('Jobs')
  const jobs = useLoaded<Listed<Job>>('v1/jobs?limit=100', POLL)
  const captures = useLoaded<Listed<Capture>>('v1/captures?limit=200')
  const ready = captures.data?.items.filter((one) => (one.state ?? 'ready') === 'ready')
  return (
    <>
      <Head title="Jobs" note="A training makes a model of the photographs of a capture." />
      <div class="stack">
        {ready?.length ? <NewTraining captures={ready} chosen={capture} jobs={jobs.data?.items ?? []} /> : ready ? <p class="card empty">A training needs photographs. <a href={link(['captures'])}>Add some, or try the sample</a>.</p> : null}
        <Failure error={jobs.error ?? captures.error} retry={jobs.reload} />
        {jobs.data?.items.length ? <Table of={jobs.data.items} captures={captures.data?.items ?? []} /> : null}
      </div>
    </>
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
          <thead><tr><th>Compare</th><th><span class="skip">Picture</span></th><th>Name</th><th>State</th><th>Progress</th><th>Plan</th><th>Added</th></tr></thead>
          <tbody>
            {jobs.map((job) => {
              const capture = captureOf(job)
              const name = job.name ?? (capture ? `${called(capture, 'Capture')}, ${planOf(job)}` : called(job, 'Job'))
              return (
                <tr key={job.id}>
                  <td><input type="checkbox" aria-label={`Compare ${name}`} checked={chosen.includes(job.id)} onChange={(event) => choose(job.id, event.currentTarget.checked)} /></td>
                  <td><div class="thumb"><Picture path={job.model ? `v1/models/${job.model}/thumbnail?size=96&env=studio` : undefined} alt="" /></div></td>
                  <td><a href={link(['jobs', job.id])}>{name}</a></td>
                  <td><Badge state={job.state} /></td>
                  <td><Progress of={job} name={name} /></td>
                  <td>{planOf(job)}</td>
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

function Progress({ of: { state, progress, started_at, finished_at }, name }: { of: Job; name: string }) {
  if (state === 'running') return <progress aria-label={`Progress of ${name}`} value={progress.step} max={progress.total} />
  if (state === 'queued') return <>waits</>
  return <>{started_at && finished_at ? `took ${spoken((Date.parse(finished_at) - Date.parse(started_at)) / 1000)}` : '–'}</>
}
