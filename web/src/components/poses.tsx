import { duration } from '../format'
import { useText } from '../hooks'
import type { PosesProgress } from '../api/types'

/** Interval between two requests for an unfinished capture, milliseconds. */
export const POLL = 1500

const STAGES: Record<PosesProgress['stage'], string> = {
  waiting: 'The search starts soon',
  features: 'Looking for features of each photograph',
  matching: 'Looking for features that photographs share',
  placing: 'Placing the photographs one after the other',
}

/** The progress of the search for poses. */
export function Poses({ of: { stage, done }, since }: { of: PosesProgress; since: string }) {
  const percent = Math.floor(100 * done)
  // Screen readers announce steps of 10 %, not every photograph.
  const spoken = stage === 'waiting' ? STAGES.waiting : `${STAGES[stage]}, ${10 * Math.floor(percent / 10)} %`
  return (
    <section class="card stack" aria-labelledby="poses">
      <h2 id="poses">Finding where the photographs were taken</h2>
      <p>{STAGES[stage]}</p>
      {stage === 'waiting' ? null : <progress value={done} max={1} aria-label={STAGES[stage]} />}
      <p class="muted small">The server compares each photograph with the others. 50 photographs take some minutes, hundreds take hours. {duration((Date.now() - Date.parse(since)) / 1000)} have passed. You may close this page; the search continues. <em>Delete</em> stops it.</p>
      <span aria-live="polite" class="skip">{spoken}</span>
    </section>
  )
}

/** The log of COLMAP, reloaded while COLMAP runs; nothing if the log is empty. */
export function Log({ capture, works }: { capture: string; works: boolean }) {
  const text = useText(`v1/captures/${encodeURIComponent(capture)}/log`, works ? POLL : undefined)
  if (!text) return null
  return (
    <section class="card" aria-label="Log">
      <details>
        <summary>Details: the output of COLMAP</summary>
        <pre class="log" tabIndex={0} aria-label="Log of COLMAP">{text}</pre>
      </details>
    </section>
  )
}
