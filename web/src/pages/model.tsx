import { useCallback, useEffect, useRef, useState } from 'preact/hooks'
import { ask, patch, remove } from '../api/client'
import { explain, type PageError } from '../api/page-error'
import type { Environments, MaterialEdit, Model } from '../api/types'
import { Calibration } from '../components/calibration'
import { Choices, Facts, Failure, Head, Missing, save, Slider } from '../components/common'
import { Confidence } from '../components/confidence'
import { Lights } from '../components/lights'
import { Lamps } from '../components/lamps'
import { LightComparison } from '../components/light-comparison'
import { Materials } from '../components/materials'
import { TakeAlong } from '../components/take'
import { ViewerPanel } from '../components/viewer-panel'
import { Wipe } from '../components/wipe'
import { bytes, called, count, decibels, duration, quality, share } from '../format'
import { useLoaded, useTitle } from '../hooks'
import { readStaging, writtenStaging, type Staging } from '../lamps'
import { OUTPUTS, readLook, written, type Look, type View } from '../look'
import { describe, go, link } from '../router'
import type { RelumeViewer } from '../viewer/element'

/** Labels of the layers. */
const LAYERS: Record<(typeof OUTPUTS)[number], string> = {
  rgb: 'picture', albedo: 'albedo (own colour)', normal: 'normals', roughness: 'roughness', metalness: 'metalness', ao: 'ambient occlusion', depth: 'depth',
}

/** The state of the page that its address contains: look, camera, lamps and ground. */
function useAddress(id: string, query: URLSearchParams) {
  const [look, setLook] = useState<Look>(() => readLook(query))
  const [view, setView] = useState<View>()
  const [centre, setCentre] = useState<View['target']>()
  const [staging, setStaging] = useState<Staging>(() => readStaging(query))
  const change = (some: Partial<Look>) => setLook((before) => ({ ...before, ...some }))
  useEffect(() => {
    const wait = setTimeout(() => describe(['models', id], { ...written(look, view, centre), ...writtenStaging(staging) }), 200)
    return () => clearTimeout(wait)
  }, [id, look, view, centre, staging])
  const seen = useCallback((view: View, isFirst: boolean) => {
    setView(view)
    if (isFirst) setCentre((before) => before ?? view.target)
  }, [])
  return { look, view, centre, staging, change, setStaging, seen }
}

export function ModelPage({ id, query }: { id: string; query: URLSearchParams }) {
  const { data: model, error, reload } = useLoaded<Model>(`v1/models/${encodeURIComponent(id)}`)
  const lights = useLoaded<Environments>('v1/environments?limit=100')
  const { look, view, centre, staging, change, setStaging, seen } = useAddress(id, query)
  const [edits, setEdits] = useState<MaterialEdit[]>([])
  const viewer = useRef<RelumeViewer>(null)
  const [failed, setFailed] = useState<PageError>()
  useTitle(model ? called(model, 'Model') : 'Model')
  const discard = () => {
    if (!confirm('Delete this model and its files?')) return
    remove(`v1/models/${encodeURIComponent(id)}`).then(() => go(link(['models'])), (failure: unknown) => setFailed(explain(failure)))
  }
  const back = { to: link(['models']), label: 'Models' }
  if (error && !model) return <Missing what="model" back={back} error={error} retry={reload} />
  // Another version after a calibration: all pictures are loaded again.
  const version = model?.files.map((file) => file.sha256).join()
  const rename = (name: string) => patch(`v1/models/${encodeURIComponent(id)}`, { name }).then(reload)
  return (
    <>
      <Head title={model ? called(model, 'Model') : 'Model'} back={back} rename={model ? rename : undefined} note={model ? <><a href={link(['jobs', model.job])}>training</a> · <a href={link(['captures', model.capture])}>photographs</a></> : null}>
        {model ? <button type="button" class="quiet danger" onClick={discard}>Delete</button> : null}
      </Head>
      <Failure error={error ?? failed} retry={reload} />
      {model ? (
        <div class="viewing">
          <div class="stack">
            <ViewerPanel key={`viewer ${version}`} viewer={viewer} model={model} look={look} query={view ? new URLSearchParams(written(look, view, centre)) : query} lights={lights.data} onView={seen} view={view} onRotation={(rotation) => change({ rotation })} />
            <Materials key={`materials ${version}`} model={model} look={look} view={view} lights={lights.data} edits={edits} onChange={setEdits} />
            <Lamps key={`lamps ${version}`} model={model} look={look} view={view} lights={lights.data} edits={edits} staging={staging} onChange={setStaging} />
            <Confidence key={`confidence ${version}`} model={model} look={look} view={view} lights={lights.data} onTurn={(...to) => viewer.current?.turnTo(...to)} />
            <LightComparison key={`lights ${version}`} model={id} view={view} lights={lights.data} onChange={(light) => change({ light })} />
            <section class="card stack" aria-labelledby="wipe">
              <h2 id="wipe">Against a photograph</h2>
              <Wipe key={`wipe ${version}`} model={id} capture={model.capture} look={look} lights={lights.data} />
            </section>
          </div>
          <div class="stack">
            <section class="card stack look" aria-label="Look">
              <Lights key={`choices ${version}`} model={id} value={look.light} lights={lights.data} onChange={(light) => change({ light })} onAdded={lights.reload} />
              <Slider label="Turn the light" value={look.rotation} min={-180} max={180} step={5} unit="°" onInput={(rotation) => change({ rotation })} />
              <Slider label="Exposure" value={look.exposure} min={-4} max={4} step={0.25} unit=" EV" onInput={(exposure) => change({ exposure })} />
              <Background value={look.background} onChange={(background) => change({ background })} />
              <details open={look.output !== 'rgb'}>
                <summary>Details: layers of the model</summary>
                <Choices legend="Layer" name="output" pills value={look.output} of={OUTPUTS.map((value) => ({ value, label: LAYERS[value] }))} onChange={(output) => change({ output })} />
              </details>
            </section>
            <Figures of={model} />
            <Calibration model={model} onDone={reload} />
            <TakeAlong model={model.id} look={look} view={view} lights={lights.data} edits={edits} staging={staging} />
            <Files of={model} onError={setFailed} />
          </div>
        </div>
      ) : null}
    </>
  )
}

function Background({ value, onChange }: { value: string; onChange: (background: string) => void }) {
  const isColour = value.startsWith('#')
  const of = [{ value: 'transparent', label: 'none' }, { value: 'environment', label: 'the light' }, { value: 'colour', label: 'a colour' }]
  return (
    <div class="row">
      <Choices legend="Background" name="background" pills value={isColour ? 'colour' : value} of={of} onChange={(chosen) => onChange(chosen === 'colour' ? '#f4f1ea' : chosen)} />
      {isColour ? <input type="color" aria-label="Colour of the background" value={value} onInput={(event) => onChange(event.currentTarget.value)} /> : null}
    </div>
  )
}

/** The fields of a model card that the page shows. */
interface Card {
  figures?: { novel_view?: { psnr?: number; ssim?: number } }
  training_seconds?: number
  steps?: number
  photographs?: number
  engine?: string
  config?: { preset?: string; resolution?: number }
}

function Figures({ of: model }: { of: Model }) {
  const card = model.card as Card
  const psnr = card.figures?.novel_view?.psnr
  return (
    <section class="card stack" aria-labelledby="card">
      <h2 id="card">Quality: {quality(psnr, card.config?.resolution)}</h2>
      <Facts of={[['Photographs', count(card.photographs)], ['Training', duration(card.training_seconds)]]} />
      <details>
        <summary>Details</summary>
        <Facts of={[
          ['Held-out PSNR', decibels(psnr)],
          ['SSIM', share(card.figures?.novel_view?.ssim)],
          ['Gaussians', count(model.gaussians)],
          ['Preset', card.config?.preset ?? '–'],
          ['Steps', count(card.steps)],
        ]} />
      </details>
    </section>
  )
}

function Files({ of: model, onError }: { of: Model; onError: (error: PageError) => void }) {
  // `fetch` sends the API key; a link does not.
  const fetchFile = (href: string, name: string) => ask(href, { cache: 'no-cache' }).then((answer) => answer.blob()).then((blob) => save(blob, name), (error: unknown) => onError(explain(error)))
  return (
    <section class="card" aria-labelledby="files">
      <h2 id="files">Files</h2>
      <ul class="notices">
        {model.files.map((file) => (
          <li class="row" key={file.name}>
            <button type="button" onClick={() => void fetchFile(file.href, file.name)}>↓ {file.name}</button>
            <span class="muted small">{bytes(file.bytes)}</span>
          </li>
        ))}
      </ul>
    </section>
  )
}
