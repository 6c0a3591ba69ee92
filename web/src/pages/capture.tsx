import { useEffect, useState } from 'preact/hooks'
import { patch, remove } from '../api/client'
import { explain, pageErrorOf, type PageError } from '../api/page-error'
import type { Capture, Photographs, Report } from '../api/types'
import { Facts, Failure, Head, Missing } from '../components/common'
import { Notify } from '../components/notify'
import { PhotographList } from '../components/photographs'
import { Log, POLL, Poses } from '../components/poses'
import { Rig } from '../components/rig'
import { bytes, called } from '../format'
import { useLoaded, useTitle } from '../hooks'
import { go, link } from '../router'

export function CapturePage({ id }: { id: string }) {
  const [isWaiting, setIsWaiting] = useState(false)
  const { data: capture, error, reload } = useLoaded<Capture>(`v1/captures/${encodeURIComponent(id)}`, isWaiting ? POLL : undefined)
  useEffect(() => setIsWaiting(capture?.state === 'validating'), [capture?.state])
  const isReady = capture && (capture.state ?? 'ready') === 'ready'
  const taken = useLoaded<Photographs>(isReady ? `v1/captures/${encodeURIComponent(id)}/photographs?convention=opengl` : undefined)
  const [failed, setFailed] = useState<PageError>()
  useTitle(capture ? called(capture, 'Capture') : 'Capture')
  const discard = () => {
    if (!confirm('Delete this capture? Models that were made of it stay.')) return
    remove(`v1/captures/${encodeURIComponent(id)}`).then(() => go(link(['captures'])), (failure: unknown) => setFailed(explain(failure)))
  }
  const back = { to: link(['captures']), label: 'Captures' }
  if (error && !capture) return <Missing what="capture" back={back} error={error} retry={reload} />
  const rename = (name: string) => patch(`v1/captures/${encodeURIComponent(id)}`, { name }).then(reload)
  return (
    <>
      <Head title={capture ? called(capture, 'Capture') : 'Capture'} badge={capture ? capture.state ?? 'ready' : undefined} back={back} rename={capture ? rename : undefined}>
        {isReady ? <a class="button primary" href={link(['jobs'], { capture: id })}>Train a model</a> : null}
        {capture ? <button type="button" class="quiet danger" onClick={discard}>Delete</button> : null}
      </Head>
      <Failure error={error ?? failed} retry={reload} />
      {capture ? <Notify isOver={capture.state !== 'validating'} text={`${called(capture, 'The capture')}: ${capture.state ?? 'ready'}`} /> : null}
      {capture ? (
        <div class={isReady ? 'split' : 'stack'}>
          {isReady ? null : <Validation of={capture} />}
          <div class="stack">
            {isReady ? (
              <section class="card" aria-labelledby="cameras">
                <h2 id="cameras">Where the photographs were taken</h2>
                {taken.data ? <Rig cameras={taken.data.photographs} report={capture.report} /> : <div class="rig" />}
                <p class="legend"><span class="a">used for the model</span><span class="b">held out, to judge the model</span></p>
                <Failure error={taken.error} retry={taken.reload} />
              </section>
            ) : null}
            {capture.poses ? <Poses of={capture.poses} since={capture.created_at} /> : null}
            {taken.data ? <section class="card stack" aria-labelledby="photographs"><h2 id="photographs">Photographs</h2><PhotographList of={taken.data.photographs} /></section> : null}
            {!isReady || capture.made_of ? <Log capture={id} works={isWaiting} /> : null}
          </div>
          {isReady ? <Validation of={capture} /> : null}
        </div>
      ) : null}
    </>
  )
}

function Validation({ of: { report, bytes: size, problem, state } }: { of: Capture }) {
  return (
    <section class="card stack" aria-labelledby="report">
      <h2 id="report">What the server found</h2>
      <Failure error={problem ? pageErrorOf(problem, problem.status) : undefined} />
      {problem ? <div class="row"><a class="button" href={link(['captures'])}>Send other files</a></div> : null}
      {state === 'validating' ? <p>The server checks the files.</p> : null}
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
        ['Photographs', report.train_images + report.test_images],
        ['Held out', report.test_images],
        ['Pixels', `${report.width} × ${report.height}`],
        ['Background', report.has_alpha ? 'masked out' : 'visible'],
      ]} />
      <h3>{warnings.length ? 'Worth knowing' : 'No warnings'}</h3>
      <ul class="notices">{warnings.map((warning) => <li key={warning} class="notice small">{warning}</li>)}</ul>
      <details>
        <summary>Details</summary>
        <div class="stack">
          <Facts of={[['Layout', report.layout], ['Points', report.points], ['Radius', <>{report.radius.toFixed(2)} <small>units</small></>], ['Archive', bytes(size)]]} />
          {facts.length ? <h3>Decided from the files</h3> : null}
          <ul class="small">{facts.map((fact) => <li key={fact}>{fact}</li>)}</ul>
        </div>
      </details>
    </>
  )
}
