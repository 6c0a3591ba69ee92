import type { ComponentChildren } from 'preact'
import { useEffect, useState } from 'preact/hooks'
import { patch, post, remove } from '../api/client'
import { explain, type PageError } from '../api/page-error'
import { hasEnded, jobEvents, type JobEvent } from '../api/events'
import type { Job, JobState, Model } from '../api/types'
import { Facts, Failure, Head, Missing } from '../components/common'
import { Notify } from '../components/notify'
import { Plot } from '../components/plot'
import { called, count, decibels, duration, moment, planOf, quality, share } from '../format'
import { useLoaded, useTitle, useWatched } from '../hooks'
import { go, link } from '../router'

/** Interval between two requests for the preview, milliseconds. */
const LOOK = 1500

/** Interval between two requests for an unfinished job, milliseconds. */
const POLL = 5000

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

/** Messages of training steps: the second is that of a time budget. Other activities repeat the figures of the last step. */
const TRAINS = /^(training$|planned:)/

/** A figure of the training as a function of the step. */
export function curve(events: JobEvent[], figure: 'psnr' | 'loss'): { points: { x: number; y: number }[] } {
  const points = events.flatMap((event) => {
    const value = event.kind === 'progress' && TRAINS.test(event.message ?? '') ? event[figure] : undefined
    return event.kind === 'progress' && value != null ? [{ x: event.step, y: value }] : []
  })
  return { points }
}

export function JobPage({ id }: { id: string }) {
  const path = `v1/jobs/${encodeURIComponent(id)}`
  const [isOver, setOver] = useState(true)
  // The events have the progress; the poll tells whether the server still answers.
  const { data: job, error, reload } = useLoaded<Job>(path, isOver ? undefined : POLL)
  const events = useEvents(id)
  const [failed, setFailed] = useState<PageError>()
  const states = events.filter((event) => event.kind === 'state')
  const state = states.at(-1)?.state ?? job?.state
  useTitle(job ? called(job, 'Job') : 'Job')
  useEffect(reload, [state, reload])
  useEffect(() => setOver(hasEnded(state)), [state])
  const attempt = (work: Promise<unknown>) => work.then(reload, (failure: unknown) => setFailed(explain(failure)))
  const retry = () => post<Job>(`${path}/retry`).then((made) => go(link(['jobs', made.id])))
  const discard = () => confirm('Delete this job? Its model stays.') && attempt(remove(path).then(() => go(link(['jobs']))))
  const back = { to: link(['jobs']), label: 'Jobs' }
  if (error && !job) return <Missing what="training" back={back} error={error} retry={reload} />
  const name = job ? called(job, 'Job') : 'Job'
  const rename = (name: string) => patch(path, { name }).then(reload)
  return (
    <>
      <Head title={name} badge={state} back={back} rename={job ? rename : undefined} note={job ? <>{planOf(job)} · <a href={link(['captures', job.capture])}>photographs</a> · {moment(job.created_at)}</> : null}>
        {job?.model ? <a class="button primary" href={link(['models', job.model])}>Open the model</a> : null}
        {state === 'failed' || state === 'cancelled' ? <button type="button" onClick={() => void attempt(retry())}>Run again</button> : null}
        {state === 'queued' || state === 'running' ? <button type="button" class="danger" onClick={() => void attempt(post(`${path}/cancel`))}>Cancel</button> : null}
        {hasEnded(state) ? <button type="button" class="quiet danger" onClick={discard}>Delete</button> : null}
      </Head>
      <Failure error={error ?? failed} retry={reload} />
      {job && state ? <Live job={job} state={state} events={events} /> : null}
    </>
  )
}

/** Values whose mean is shown as the current quality: each step shows another photograph. */
const RECENT = 40

function Live({ job, state, events }: { job: Job; state: JobState; events: JobEvent[] }) {
  const now = events.filter((event) => event.kind === 'progress').at(-1) ?? job.progress
  const warnings = events.flatMap((event) => (event.kind === 'warning' ? [event.message] : []))
  const percent = Math.floor((100 * now.step) / Math.max(now.total, 1))
  const psnr = curve(events, 'psnr').points.slice(-RECENT).map(({ y }) => y)
  const soFar = psnr.length ? psnr.reduce((sum, y) => sum + y, 0) / psnr.length : undefined
  const judged = job.figures?.novel_view?.psnr
  const isOver = hasEnded(state)
  const took = job.started_at && job.finished_at ? (Date.parse(job.finished_at) - Date.parse(job.started_at)) / 1000 : undefined
  return (
    <div class="split">
      <div class="stack">
        <section class="card stack" aria-labelledby="progress">
          <h2 id="progress">Progress</h2>
          <progress value={now.step} max={now.total} aria-labelledby="progress" />
          <span class="skip" aria-live="polite">{state}, {Math.floor(percent / 10) * 10} % done</span>
          <Facts of={[
            isOver ? ['Took', duration(took)] : ['Time left', state === 'running' ? duration(now.eta_seconds) : 'waits'],
            ['Done', `${percent} %`],
            [isOver ? 'Quality' : 'Quality so far', quality(judged ?? soFar)],
          ]} />
          {job.queue_position != null && state === 'queued' ? <p class="notice">{job.queue_position === 0 ? 'Next in the queue' : job.queue_position === 1 ? 'One training runs before this one' : `${job.queue_position} trainings run before this one`}</p> : null}
          <Failure error={job.error ? { what: 'The training failed.', remedy: 'Run it again. If it fails again, try fewer or smaller photographs.', detail: `${job.error.code}: ${job.error.detail}` } : undefined} />
          <Notify isOver={isOver} text={`${called(job, 'The training')}: ${state}`} />
        </section>
        <section class="card" aria-label="Details">
          <details>
            <summary>Details</summary>
            <div class="stack">
              {state === 'running' && now.message ? <p class="small muted">{now.message}</p> : null}
              <Facts of={[
                ['Step', <>{count(now.step)} <small>of {count(now.total)}</small></>],
                ['PSNR', decibels(now.psnr)],
                ['Loss', share(now.loss)],
                ['Gaussians', count(now.gaussians)],
              ]} />
              <div class="halves">
                <figure><h3>PSNR, dB</h3><Plot title="PSNR" unit="dB" curves={[curve(events, 'psnr')]} end={now.total} /></figure>
                <figure><h3>Loss</h3><Plot title="Loss" unit="" curves={[curve(events, 'loss')]} end={now.total} log /></figure>
              </div>
              <Settings job={job} />
            </div>
          </details>
        </section>
      </div>
      <div class="stack">
        <Preview job={job} state={state} total={now.total} />
        {job.figures ? <Figures job={job} /> : null}
        {warnings.length ? <section class="card" aria-labelledby="warnings"><h2 id="warnings">Warnings</h2><ul class="notices">{warnings.map((warning) => <li key={warning} class="notice small">{warning}</li>)}</ul></section> : null}
      </div>
    </div>
  )
}

/** A preview of the model during the training. */
function Preview({ job, state, total }: { job: Job; state: JobState; total: number }) {
  const isOver = hasEnded(state)
  const { url, step } = useWatched(isOver && !job.model ? undefined : `v1/jobs/${encodeURIComponent(job.id)}/preview?size=448`, job.model ? 1e8 : LOOK)
  if (isOver && !job.model) return null
  const seen = job.model ? 'The finished model' : `The model at step ${step ?? ''}`
  const waits = isOver ? 'The picture is being loaded' : state === 'queued' ? 'The first picture comes after the training has started' : 'The first picture comes soon'
  return (
    <div class="preview">
      {url ? <img src={url} alt={seen} /> : <p>{waits}</p>}
      {url && step && !job.model ? <span class="step">at {Math.floor((100 * Number(step)) / Math.max(total, 1))} % of the training</span> : null}
    </div>
  )
}

/** The longest side of the photographs in the training of a model, pixels. */
function useTrainedSide(model: string | null | undefined): number | undefined {
  const { data } = useLoaded<Model>(model ? `v1/models/${model}` : undefined)
  return (data?.card as { config?: { resolution?: number } } | undefined)?.config?.resolution
}

function Figures({ job }: { job: Job }) {
  const { figures, quality_gate: gate, missed } = job
  const side = useTrainedSide(job.model)
  if (!figures) return null
  const psnr = figures.novel_view?.psnr
  return (
    <section class="card stack" aria-labelledby="figures">
      <h2 id="figures">Quality: {quality(psnr, side)}</h2>
      <p class="small muted">{figures.views ? `Compared with ${figures.views} photograph${figures.views === 1 ? '' : 's'} that the training did not see, at the size of the training. A longer training is sharper.` : 'Nothing could be compared.'}</p>
      {Object.entries(gate ?? {}).map(([figure, bound]) => {
        const miss = missed?.find((one) => one.figure === figure)
        return <p key={figure} class={miss ? 'notice bad' : 'notice good'}>Gate {figure} {bound}: {miss ? 'missed' : 'reached'}</p>
      })}
      {figures.note ? <p class="hint">{figures.note}</p> : null}
      <details>
        <summary>Details</summary>
        <Facts of={[
          ['PSNR', decibels(psnr)],
          ['SSIM', share(figures.novel_view?.ssim)],
          ['Matched exposure', decibels(figures.novel_view_matched?.psnr)],
          ['Views', `${figures.views} of ${figures.held_out_views}`],
        ]} />
      </details>
    </section>
  )
}

function Settings({ job }: { job: Job }) {
  const overrides = Object.entries(job.overrides)
  return (
    <Facts of={[
      ['Preset', job.overrides.time_budget_s ? 'none' : job.preset],
      ['Device', job.device],
      ...overrides.map(([name, value]): [string, ComponentChildren] => [name, typeof value === 'object' ? JSON.stringify(value) : String(value)]),
      ['Started', <span class="small">{moment(job.started_at)}</span>],
      ['Ended', <span class="small">{moment(job.finished_at)}</span>],
    ]} />
  )
}
