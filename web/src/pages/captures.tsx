import type { Capture, Listed, Upload } from '../api/types'
import { Badge, Failure, Head } from '../components/common'
import { DropZone } from '../components/dropzone'
import { bytes, called, moment } from '../format'
import { useLoaded, useTitle } from '../hooks'
import { go, link } from '../router'

export function CapturesPage() {
  useTitle('Captures')
  const captures = useLoaded<Listed<Capture>>('v1/captures?limit=100')
  const items = captures.data?.items
  return (
    <>
      <Head title="Captures" note="Photographs with known cameras. What a model is trained from." />
      <div class="stack">
        <DropZone onDone={(capture) => go(link(['captures', capture.id]))} />
        <Failure error={captures.error} />
        <Unmade />
        {items?.length ? <Table of={items} /> : items ? <p class="empty">No captures yet. <code>relume sample capture.zip</code> writes a small one to try.</p> : null}
      </div>
    </>
  )
}

/** Uploads whose captures are not ready or failed. The list of captures has only ready ones. */
function Unmade() {
  const uploads = useLoaded<Listed<Upload>>('v1/uploads?limit=100', 5000)
  const unmade = (uploads.data?.items ?? []).filter(({ capture }) => capture)
  if (!unmade.length) return null
  return (
    <section class="card" aria-labelledby="unmade">
      <h2 id="unmade">Being made</h2>
      <ul class="notices">
        {unmade.map((upload) => <li class="row" key={upload.id}><a href={link(['captures', upload.capture ?? ''])}>{upload.filename ?? moment(upload.created_at)}</a><Badge state={upload.state ?? 'complete'} /></li>)}
      </ul>
    </section>
  )
}

function Table({ of: captures }: { of: Capture[] }) {
  return (
    <section class="card" aria-labelledby="all-captures">
      <h2 id="all-captures">All captures</h2>
      <div class="scroll">
        <table>
          <thead><tr><th>Name</th><th>State</th><th class="number">Photographs</th><th class="number">Size</th><th>Layout</th><th>Added</th></tr></thead>
          <tbody>
            {captures.map((capture) => (
              <tr key={capture.id}>
                <td><a href={link(['captures', capture.id])}>{called(capture, 'Capture')}</a></td>
                <td><Badge state={capture.state ?? 'ready'} /></td>
                <td class="number">{capture.report.train_images + capture.report.test_images}</td>
                <td class="number">{bytes(capture.bytes)}</td>
                <td>{capture.report.layout}</td>
                <td class="muted">{moment(capture.created_at)}</td>
              </tr>
            ))}
          </tbody>
        </table>
      </div>
    </section>
  )
}
