import { useState } from 'preact/hooks'
import { message, remove } from '../api/client'
import type { Capture, Photographs } from '../api/types'
import { Facts, Failure, Head } from '../components/common'
import { PhotographList } from '../components/photographs'
import { Rig } from '../components/rig'
import { bytes, called } from '../format'
import { useLoaded, useTitle } from '../hooks'
import { go, link } from '../router'

export function CapturePage({ id }: { id: string }) {
  const { data: capture, error } = useLoaded<Capture>(`v1/captures/${encodeURIComponent(id)}`)
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
            <section class="card" aria-labelledby="cameras">
              <h2 id="cameras">Cameras</h2>
              {taken.data ? <Rig cameras={taken.data.photographs} report={capture.report} /> : <div class="rig" />}
              <p class="legend"><span class="a">trained on</span><span class="b">held out, to judge the model</span></p>
              <Failure error={taken.error} />
            </section>
            {taken.data ? <section class="card stack" aria-labelledby="photographs"><h2 id="photographs">Photographs</h2><PhotographList of={taken.data.photographs} /></section> : null}
          </div>
          <Validation of={capture} />
        </div>
      ) : null}
    </>
  )
}

function Validation({ of: { report, bytes: size, problem } }: { of: Capture }) {
  const warnings = [...report.warnings, ...(report.notes ?? []).map(({ text }) => text)]
  return (
    <section class="card stack" aria-labelledby="report">
      <h2 id="report">Validation</h2>
      {problem ? <p class="notice bad">{problem.detail ?? problem.title}</p> : null}
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
    </section>
  )
}
