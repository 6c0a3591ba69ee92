import type { ComponentChildren } from 'preact'
import { useEffect, useState } from 'preact/hooks'
import { message, post, remove } from '../api/client'
import { hasEnded, jobEvents, type JobEvent } from '../api/events'
import type { Job, JobState } from '../api/types'
import { Facts, Failure, Head } from '../components/common'
import { Plot } from '../components/plot'
import { called, count, decibels, duration, moment, share } from '../format'
import { useLoaded, useTitle, useWatched } from '../hooks'
import { go, link } from '../router'

/** Interval between two requests for the preview, milliseconds. */
const LOOK = 1500

/** The events that have arrived for a job. */
export function useEvents(id: string | undefined): JobEvent[] {
  const [events, setEvents] = useState<JobEvent[]>([])
  useEffect(() => {
    setEvents([])
    if (!id) return
    const stop = new AbortController()
    void (async () => {
      for await (const some of jobEvents(id, stop.signal)) setEvents((before) => [...before, ...some])
    })().catch(() => {})
    return () => stop.abort()
  }, [id])
  return events
}

/** A figure of the training as a function of the step. */
export function curve(events: JobEvent[], figure: 'psnr' | 'loss'): { points: { x: number; y: number }[] } {
  const points = events.flatMap((event) => {
    const value = event.kind === 'progress' && event.message === 'training' ? event[figure] : undefined
    return event.kind === 'progress' && value != null ? [{ x: event.step, y: value }] : []
  })
  return { points }
}

export function JobPage({ id }: { id: string }) {
  const path = `v1/jobs/${encodeURIComponent(id)}`
  const { data: job, error, reload } = useLoaded<Job>(path)
  const events = useEvents(id)
  const [failed, setFailed] = useState<string>()
  const states = events.filter((event) => event.kind === 'state')
  const state = states.at(-1)?.state ?? job?.state
  useTitle(job ? called(job, 'Job') : 'Job')
  useEffect(reload, [state, reload])
  const attempt = (work: Promise<unknown>) => work.then(reload, (failure: unknown) => setFailed(message(failure)))
  const retry = () => post<Job>(`${path}/retry`).then((made) => go(link(['jobs', made.id])))
  const discard = () => confirm('Delete this job? Its model stays.') && attempt(remove(path).then(() => go(link(['jobs']))))
  return (
    <>
      <Head title={job ? called(job, 'Job') : 'Job'} badge={state} back={{ to: link(['jobs']), label: 'Jobs' }} note={job ? <>{job.preset} · <a href={link(['captures', job.capture])}>capture</a> · {moment(job.created_at)}</> : null}>
        {job?.model ? <a class="button primary" href={link(['models', job.model])}>Open the model</a> : null}
        {state === 'failed' || state === 'cancelled' ? <button type="button" onClick={() => void attempt(retry())}>Run again</button> : null}
        {state === 'queued' || state === 'running' ? <button type="button" class="danger" onClick={() => void attempt(post(`${path}/cancel`))}>Cancel</button> : null}
        {hasEnded(state) ? <button type="button" class="quiet danger" onClick={discard}>Delete</button> : null}
      </Head>
      <Failure error={error ?? failed} />
      {job && state ? <Live job={job} state={state} events={events} /> : null}
    </>
  )
}

function Live({ job, state, events }: { job: Job; state: JobState; events: JobEvent[] }) {
  const told = events.filter((event) => event.kind === 'progress').at(-1)
  const now = told ?? job.progress
  const warnings = events.flatMap((event) => (event.kind === 'warning' ? [event.message] : []))
  const percent = Math.floor((100 * now.step) / Math.max(now.total, 1))
  return (
    <div class="split">
      <div class="stack">
        <section class="card stack" aria-labelledby="progress">
          <div class="row"><h2 id="progress" style={{ flex: '1' }}>Progress</h2><span class="muted small">{state === 'running' ? now.message ?? '' : ''}</span></div>
          <progress value={now.step} max={now.total} aria-labelledby="progress" />
          <span class="skip" aria-live="polite">{state}, {Math.floor(percent / 10) * 10} % done</span>
          <Facts of={[
            ['Step', <>{count(now.step)} <small>of {count(now.total)}</small></>],
            ['PSNR', decibels(now.psnr)],
            ['Loss', share(now.loss)],
            ['Gaussians', count(now.gaussians)],
            ['Left', state === 'running' ? duration(now.eta_seconds) : '–'],
          ]} />
          {job.queue_position != null && state === 'queued' ? <p class="notice">{job.queue_position === 0 ? 'Next in the queue' : `${job.queue_position} jobs run before this one`}</p> : null}
          {job.error ? <p class="notice bad"><strong>{job.error.code}</strong>: {job.error.detail}</p> : null}
        </section>
        <section class="card halves" aria-label="Curves">
          <figure><h3>PSNR, dB</h3><Plot title="PSNR" unit="dB" curves={[curve(events, 'psnr')]} end={now.total} /></figure>
          <figure><h3>Loss</h3><Plot title="Loss" unit="" curves={[curve(events, 'loss')]} end={now.total} log /></figure>
        </section>
        <Settings job={job} />
      </div>
      <div class="stack">
        <Preview job={job} state={state} />
        {job.figures ? <Figures job={job} /> : null}
        {warnings.length ? <section class="card" aria-labelledby="warnings"><h2 id="warnings">Warnings</h2><ul class="notices">{warnings.map((warning) => <li key={warning} class="notice small">{warning}</li>)}</ul></section> : null}
      </div>
    </div>
  )
}

/** A preview of the model during the training. */
function Preview({ job, state }: { job: Job; state: JobState }) {
  const isOver = hasEnded(state) && !job.model
  const { url, step, why } = useWatched(isOver ? undefined : `v1/jobs/${encodeURIComponent(job.id)}/preview?size=448`, job.model ? 1e8 : LOOK)
  if (isOver) return null
  const seen = job.model ? 'The finished model' : `The model at step ${step ?? ''}`
  return (
    <div class="preview">
      {url ? <img src={url} alt={seen} /> : <p>{why ?? 'Looking at the training'}</p>}
      {url && step && !job.model ? <span class="step">step {count(Number(step))}</span> : null}
    </div>
  )
}

function Figures({ job }: { job: Job }) {
  const { figures, quality_gate: gate, missed } = job
  if (!figures) return null
  return (
    <section class="card stack" aria-labelledby="figures">
      <h2 id="figures">Held-out views</h2>
      <Facts of={[
        ['PSNR', decibels(figures.novel_view?.psnr)],
        ['SSIM', share(figures.novel_view?.ssim)],
        ['Matched exposure', decibels(figures.novel_view_matched?.psnr)],
        ['Views', `${figures.views} of ${figures.held_out_views}`],
      ]} />
      {Object.entries(gate ?? {}).map(([figure, bound]) => {
        const miss = missed?.find((one) => one.figure === figure)
        return <p key={figure} class={miss ? 'notice bad' : 'notice'}>Gate {figure} {bound}: {miss ? 'missed' : 'reached'}</p>
      })}
      {figures.note ? <p class="hint">{figures.note}</p> : null}
    </section>
  )
}

function Settings({ job }: { job: Job }) {
  const overrides = Object.entries(job.overrides)
  return (
    <section class="card" aria-labelledby="settings">
      <h2 id="settings">Settings</h2>
      <Facts of={[
        ['Preset', job.preset],
        ['Device', job.device],
        ...overrides.map(([name, value]): [string, ComponentChildren] => [name, typeof value === 'object' ? JSON.stringify(value) : String(value)]),
        ['Started', <span class="small">{moment(job.started_at)}</span>],
        ['Ended', <span class="small">{moment(job.finished_at)}</span>],
      ]} />
    </section>
  )
}
