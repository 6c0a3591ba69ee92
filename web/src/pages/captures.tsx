import type { Capture, Listed, Upload } from '../api/types'
import { Badge, Failure, Head } from '../components/common'
import { CaptureThumbnail } from '../components/capture-thumbnail'
import { DropZone } from '../components/dropzone'
import { called, moment } from '../format'
import { useLoaded, useTitle } from '../hooks'
import { go, link } from '../router'

export function CapturesPage() {
  useTitle('Captures')
  const captures = useLoaded<Listed<Capture>>('v1/captures?limit=100')
  const items = captures.data?.items
  return (
    <>
      <Head title="Captures" note="The photographs of one thing. The server makes a model of them that can be shown in any light." />
      <div class="stack">
        <DropZone onDone={(capture) => go(link(['captures', capture.id]))} />
        <Failure error={captures.error} retry={captures.reload} />
        <Unmade />
        {items?.length ? <Tiles of={items} /> : items ? <p class="empty">No captures yet. <em>Try the sample</em> makes a small one, so that you can look at everything without photographs.</p> : null}
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
      <h2 id="unmade">Not ready</h2>
      <ul class="notices">
        {unmade.map((upload) => <Row of={upload} key={upload.id} />)}
      </ul>
    </section>
  )
}

function Row({ of: { capture: id, filename, created_at, state } }: { of: Upload }) {
  const capture = useLoaded<Capture>(id ? `v1/captures/${encodeURIComponent(id)}` : undefined)
  return <li class="row"><a href={link(['captures', id ?? ''])}>{capture.data?.name ?? filename ?? moment(created_at)}</a><Badge state={state ?? 'complete'} /></li>
}

function Tiles({ of: captures }: { of: Capture[] }) {
  return (
    <section class="stack" aria-labelledby="all-captures">
      <h2 id="all-captures">All captures</h2>
      <ul class="tiles">
        {captures.map((capture) => (
          <li class="tile" key={capture.id}>
            <CaptureThumbnail capture={capture.id} />
            <div class="text">
              <a class="over" href={link(['captures', capture.id])}>{called(capture, 'Capture')}</a>
              <p class="muted small">{capture.report.train_images + capture.report.test_images} photographs · {moment(capture.created_at)}</p>
            </div>
          </li>
        ))}
      </ul>
    </section>
  )
}
