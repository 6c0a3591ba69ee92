import { useState } from 'preact/hooks'
import type { PageError } from '../api/page-error'
import type { Job, Model } from '../api/types'
import { Failure, Head, Picture } from '../components/common'
import { Plot } from '../components/plot'
import { called, count, decibels, duration, share } from '../format'
import { useLoaded, useTitle } from '../hooks'
import { link } from '../router'
import { curve, useEvents } from './job'

/** Settings of a model card that do not describe the training. */
const SILENT = ['forced']

export function ComparePage({ a, b }: { a: string; b: string }) {
  useTitle('Compare')
  const [first, second] = [useSide(a), useSide(b)]
  const [before, after] = [useEvents(a), useEvents(b)]
  const rows = first.isComplete && second.isComplete ? compared(first, second) : []
  const [all, setAll] = useState(false)
  const end = Math.max(first.job?.progress.total ?? 1, second.job?.progress.total ?? 1)
  const name = (side: Side) => (side.job ? called(side.job, 'Job') : '…')
  return (
    <>
      <Head title="Compare two trainings" back={{ to: link(['jobs']), label: 'Jobs' }} />
      <Failure error={first.error ?? second.error} />
      <div class="stack">
        <div class="halves">
          {[first, second].map((side, i) => (
            <figure key={i} class="card stack">
              <h2><a href={link(['jobs', i ? b : a])}>{name(side)}</a></h2>
              <div class="preview"><Picture path={side.job?.model ? `v1/models/${side.job.model}/thumbnail?size=448&env=sunset&tier=standard` : undefined} alt={`${name(side)} under sunset`} /></div>
            </figure>
          ))}
        </div>
        <section class="card stack" aria-labelledby="curves">
          <h2 id="curves">PSNR of the photographs, dB</h2>
          <p class="legend"><span class="a">{name(first)}</span><span class="b">{name(second)}</span></p>
          <Plot title="PSNR" unit="dB" curves={[curve(before, 'psnr'), curve(after, 'psnr')]} end={end} />
        </section>
        <section class="card" aria-labelledby="differences">
          <h2 id="differences">Figures and settings</h2>
          <label class="check"><input type="checkbox" checked={all} onChange={(event) => setAll(event.currentTarget.checked)} />Also what is the same</label>
          <div class="scroll">
            <table>
              <thead><tr><th>Name</th><th>{name(first)}</th><th>{name(second)}</th></tr></thead>
              <tbody>
                {rows.filter(([, one, other]) => all || one !== other).map(([label, one, other]) => (
                  <tr key={label} class={one === other ? '' : 'differs'}><th scope="row">{label}</th><td>{one}</td><td>{other}{one === other ? null : <span class="skip"> (differs)</span>}</td></tr>
                ))}
              </tbody>
            </table>
          </div>
        </section>
      </div>
    </>
  )
}

interface Side {
  job: Job | undefined
  model: Model | undefined
  error: PageError | undefined
  /** Whether all data has been loaded. */
  isComplete: boolean
}

function useSide(id: string): Side {
  const { data: job, error } = useLoaded<Job>(`v1/jobs/${encodeURIComponent(id)}`)
  const { data: model, error: missing } = useLoaded<Model>(job?.model ? `v1/models/${job.model}` : undefined)
  return { job, model, error, isComplete: job !== undefined && (!job.model || model !== undefined || missing !== undefined) }
}

type Row = [label: string, one: string, other: string]

function compared(first: Side, second: Side): Row[] {
  const [one, other] = [first, second].map(lines) as [Map<string, string>, Map<string, string>]
  return [...new Set([...one.keys(), ...other.keys()])].map((label) => [label, one.get(label) ?? '–', other.get(label) ?? '–'])
}

function lines({ job, model }: Side): Map<string, string> {
  const card = (model?.card ?? {}) as { training_seconds?: number; config?: Record<string, unknown> }
  const found = new Map<string, string>([
    ['State', job?.state ?? '–'],
    ['Held-out PSNR', decibels(job?.figures?.novel_view?.psnr)],
    ['Held-out SSIM', share(job?.figures?.novel_view?.ssim)],
    ['PSNR at matched exposure', decibels(job?.figures?.novel_view_matched?.psnr)],
    ['Gaussians', count(model?.gaussians ?? job?.progress.gaussians)],
    ['Time in training', duration(card.training_seconds)],
    ['preset', job?.preset ?? '–'],
  ])
  for (const [name, value] of flat(card.config ?? job?.overrides ?? {})) if (!SILENT.includes(name)) found.set(name, value)
  return found
}

function flat(settings: object, prefix = ''): [string, string][] {
  return Object.entries(settings).flatMap(([name, value]: [string, unknown]): [string, string][] => {
    if (value !== null && typeof value === 'object' && !Array.isArray(value)) return flat(value, `${prefix}${name}.`)
    const text = typeof value === 'number' ? String(Number(value.toPrecision(6))) : Array.isArray(value) ? value.join(', ') : String(value)
    return [[prefix + name, text]]
  })
}
