import { useEffect, useState } from 'preact/hooks'
import { message, remove } from '../api/client'
import type { Capture, Photographs, Report } from '../api/types'
import { Facts, Failure, Head } from '../components/common'
import { PhotographList } from '../components/photographs'
import { Log, POLL, Poses } from '../components/poses'
import { Rig } from '../components/rig'
import { bytes, called } from '../format'
import { useLoaded, useTitle } from '../hooks'
import { go, link } from '../router'

export function CapturePage({ id }: { id: string }) {
  const [isWaiting, setIsWaiting] = useState(false)
  const { data: capture, error } = useLoaded<Capture>(`v1/captures/${encodeURIComponent(id)}`, isWaiting ? POLL : undefined)
  useEffect(() => setIsWaiting(capture?.state === 'validating'), [capture?.state])
  const isReady = capture && (capture.state ?? 'ready') === 'ready'
  const taken = useLoaded<Photographs>(isReady ? `v1/captures/${encodeURIComponent(id)}/photographs?convention=opengl` : undefined)
  const [failed, setFailed] = useState<string>()
  useTitle(capture ? called(capture, 'Capture') : 'Capture')
  const discard = () => {
    if (!confirm('Delete this capture? Models that were made of it stay.')) return
    remove(`v1/captures/${encodeURIComponent(id)}`).then(() => go(link(['captures'])), (failure: unknown) => setFailed(message(failure)))
  }
  return (
    <>
      <Head title={capture ? called(capture, 'Capture') : 'Capture'} badge={capture ? capture.state ?? 'ready' : undefined} back={{ to: link(['captures']), label: 'Captures' }}>
        {isReady ? <a class="button primary" href={link(['jobs'], { capture: id })}>Train a model</a> : null}
        <button type="button" class="quiet danger" onClick={discard}>Delete</button>
      </Head>
      <Failure error={error ?? failed} />
      {capture ? (
        <div class="split">
          <div class="stack">
            {isReady ? (
              <section class="card" aria-labelledby="cameras">
                <h2 id="cameras">Cameras</h2>
                {taken.data ? <Rig cameras={taken.data.photographs} report={capture.report} /> : <div class="rig" />}
                <p class="legend"><span class="a">trained on</span><span class="b">held out, to judge the model</span></p>
                <Failure error={taken.error} />
              </section>
            ) : null}
            {capture.poses ? <Poses of={capture.poses} since={capture.created_at} /> : null}
            {taken.data ? <section class="card stack" aria-labelledby="photographs"><h2 id="photographs">Photographs</h2><PhotographList of={taken.data.photographs} /></section> : null}
            {capture.poses || capture.made_of || capture.state === 'invalid' ? <Log capture={id} works={isWaiting} open={!isReady} /> : null}
          </div>
          <Validation of={capture} />
        </div>
      ) : null}
    </>
  )
}

function Validation({ of: { report, bytes: size, problem, state } }: { of: Capture }) {
  return (
    <section class="card stack" aria-labelledby="report">
      <h2 id="report">Validation</h2>
      <div role="alert">{problem ? <p class="notice bad said">{problem.detail ?? problem.title}</p> : null}</div>
      {state === 'validating' ? <p>The server makes a capture of what was sent.</p> : null}
      {(state ?? 'ready') === 'ready' ? <Found report={report} size={size} /> : null}
    </section>
  )
}

function Found({ report, size }: { report: Report; size: number }) {
  const notes = report.notes ?? []
  const facts = notes.filter(({ kind }) => kind === 'fact').map(({ text }) => text)
  const warnings = [...report.warnings, ...notes.filter(({ kind }) => kind !== 'fact').map(({ text }) => text)]
  return (
    <>
      <Facts of={[
        ['Trained on', report.train_images],
        ['Held out', report.test_images],
        ['Pixels', `${report.width} × ${report.height}`],
        ['Layout', report.layout],
        ['Masks', report.has_alpha ? 'yes' : 'none'],
        ['Points', report.points],
        ['Radius', <>{report.radius.toFixed(2)} <small>units</small></>],
        ['Archive', bytes(size)],
      ]} />
      <h3>{warnings.length ? 'Worth knowing' : 'No warnings'}</h3>
      <ul class="notices">{warnings.map((warning) => <li key={warning} class="notice small">{warning}</li>)}</ul>
      {facts.length ? <h3>Decided from the files</h3> : null}
      <ul class="small">{facts.map((fact) => <li key={fact}>{fact}</li>)}</ul>
    </>
  )
}
