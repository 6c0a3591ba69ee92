import type { Capture, Listed } from '../api/types'
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
        {items?.length ? <Table of={items} /> : items ? <p class="empty">No captures yet. <code>relume sample capture.zip</code> writes a small one to try.</p> : null}
      </div>
    </>
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
