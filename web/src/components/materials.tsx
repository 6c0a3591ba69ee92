import { useCallback, useMemo, useRef, useState } from 'preact/hooks'
import { explain, type PageError } from '../api/page-error'
import type { Environments, Listed, Material, MaterialEdit, Model } from '../api/types'
import { called } from '../format'
import { useLoaded } from '../hooks'
import { requestOf, type Look, type View } from '../look'
import { useMask, useMasks } from '../material-pictures'
import { afterMerges, brightest, changed, editsFile, hasMaterials, merged, mergesOf, undone, valuesOf, type MaterialValues } from '../materials'
import { useServed } from '../rendered'
import { SerialQueue } from '../serial-queue'
import { Failure, save, Slider } from './common'

/** Width and height of the picture, pixels. */
const SIZE: [number, number] = [640, 480]

interface MaterialsProps {
  model: Model
  look: Look
  view: View | undefined
  lights: Environments | undefined
  edits: MaterialEdit[]
  onChange: (edits: MaterialEdit[]) => void
}

/** The materials of a model and changes of them. Nothing is loaded before the panel is opened. */
export function Materials(props: MaterialsProps) {
  const [isOpen, setOpen] = useState(false)
  const { model, edits } = props
  const loaded = useLoaded<Listed<Material>>(isOpen ? `v1/models/${encodeURIComponent(model.id)}/materials` : undefined)
  if (!hasMaterials(model.card)) return null
  return (
    <section class="card stack materials" aria-labelledby="materials">
      <h2 id="materials">Materials</h2>
      <p class="small muted">Change the colour, roughness or metalness of single materials. The model on the server stays as it is.</p>
      <div>
        <div class="row">
          <button type="button" aria-expanded={isOpen} onClick={() => setOpen(!isOpen)}>{isOpen ? 'Hide the materials' : 'Show the materials'}</button>
          {isOpen && !loaded.data && !loaded.error ? <span class="spinner" /> : null}
          {!isOpen && edits.length > 0 ? <span class="small">{amount(edits)} changed.</span> : null}
        </div>
        <Failure error={loaded.error} retry={loaded.reload} />
      </div>
      {isOpen && loaded.data ? <Editor {...props} materials={loaded.data.items} /> : null}
    </section>
  )
}

/** `1 material is`, `2 materials are`. */
function amount({ length }: MaterialEdit[]): string {
  return length === 1 ? '1 material is' : `${length} materials are`
}

/** The list of the materials, the picture with the changes, and the fields of the chosen material. */
function Editor({ model, look, view, lights, edits, onChange, materials: all }: MaterialsProps & { materials: Material[] }) {
  const merges = mergesOf(edits)
  const materials = useMemo(() => afterMerges(all, merges), [all, JSON.stringify(merges)])
  const [chosen, setChosen] = useState(materials[0]?.material)
  const [hovered, setHovered] = useState<number>()
  const [focused, setFocused] = useState<number>()
  const list = useRef<HTMLFieldSetElement>(null)
  const [told, setTold] = useState('')
  const [error, setError] = useState<PageError>()
  const queue = useMemo(() => new SerialQueue(), [])
  const request = view && lights ? { ...requestOf(look, view, lights.builtin, SIZE), ...(edits.length > 0 ? { materials: edits } : {}) } : undefined
  const served = useServed(model.id, request, queue, true)
  const masks = useMasks(model.id, materials, merges, served.request, queue)
  const failed = useCallback((failure: unknown) => setError(explain(failure)), [])
  const mask = useMask(masks, hovered ?? focused, failed)
  const material = materials.find((one) => one.material === chosen)
  const pick = (at: [number, number]) => {
    if (!masks) return
    setError(undefined)
    setTold('Looking for the material at this point.')
    masks.all().then((all) => {
      const found = materials[brightest(all, at) ?? -1]
      if (found) {
        setChosen(found.material)
        // The focus shows its mask, and the next fields are those of this material.
        list.current?.querySelector<HTMLInputElement>(`[value="${found.material}"]`)?.focus({ preventScroll: true })
      }
      setTold(found ? `Material ${found.material} was selected.` : 'There is no surface at this point.')
    }, (failure: unknown) => {
      setTold('')
      if (!isAbort(failure)) failed(failure)
    })
  }
  const merge = (into: number) => {
    if (chosen === undefined) return
    onChange(merged(edits, chosen, into))
    setChosen(into)
    setTold(`Material ${chosen} is now part of material ${into}.`)
  }
  return (
    <>
      <fieldset ref={list}>
        <legend>Material and its share of the surface</legend>
        <div class="swatches">
          {materials.map((one) => <Swatch key={one.material} of={one} edits={edits} isChosen={one.material === chosen} onChoose={setChosen} onHover={setHovered} onFocus={setFocused} />)}
        </div>
      </fieldset>
      <div class="halves">
        <div class="stack">
          <EditedPicture url={served.url} isOld={served.isOld} isWaiting={served.isOld && !served.error} mask={mask} onPick={pick} />
          <div>
            <p class="hint">Click on a surface in the picture to select its material. The server draws the picture from the viewer's direction, under the light of this page.</p>
            <p class="small muted" role="status">{told}</p>
            <Failure error={served.error} retry={served.retry} />
            <Failure error={error} />
          </div>
        </div>
        <div class="stack">
          {material ? <Fields of={material} edits={edits} onChange={onChange} /> : null}
          {material ? <Merge of={material} materials={materials} onMerge={merge} /> : null}
          <div class="row">
            <button type="button" disabled={edits.length === 0} onClick={() => onChange([])}>Undo all</button>
            <button type="button" disabled={edits.length === 0} onClick={() => save(new Blob([editsFile(edits)], { type: 'application/json' }), `${called(model, 'model').replace(/[^\w.-]+/g, '-')}-materials.json`)}>Save changes</button>
          </div>
          {edits.length > 0 ? <p class="small">{amount(edits)} changed. <em>Take it along</em> makes its files with the changes. The saved file is for the option <code>--edits</code> of <code>relume render</code> and <code>relume export</code>.</p> : null}
        </div>
      </div>
    </>
  )
}

function isAbort(error: unknown): boolean {
  return error instanceof DOMException && error.name === 'AbortError'
}

interface SwatchProps {
  of: Material
  edits: MaterialEdit[]
  isChosen: boolean
  onChoose: (material: number) => void
  onHover: (material: number | undefined) => void
  onFocus: (material: number | undefined) => void
}

/** One material of the list. */
function Swatch({ of, edits, isChosen, onChoose, onHover, onFocus }: SwatchProps) {
  const { material, share } = of
  const { colour, roughness, metalness } = valuesOf(of, edits)
  const isChanged = edits.some((edit) => edit.material === material || edit.into === material)
  return (
    <label class="choice" onPointerEnter={() => onHover(material)} onPointerLeave={() => onHover(undefined)}>
      <input type="radio" name="material" value={material} checked={isChosen} onChange={() => onChoose(material)} onFocus={() => onFocus(material)} onBlur={() => onFocus(undefined)} />
      <i class="swatch" style={{ background: colour }} />
      <span><b>{material}</b> · {(100 * share).toFixed(1)} %</span>
      <span class="hint">roughness {roughness.toFixed(2)}</span>
      <span class="hint">metalness {metalness.toFixed(2)}</span>
      {isChanged ? <span class="hint">changed</span> : null}
    </label>
  )
}

/** The picture of the server. The mask of a material darkens everything else. */
function EditedPicture({ url, isOld, isWaiting, mask, onPick }: { url: string | undefined; isOld: boolean; isWaiting: boolean; mask: string | undefined; onPick: (at: [number, number]) => void }) {
  const pick = (event: MouseEvent) => {
    const box = (event.currentTarget as HTMLElement).getBoundingClientRect()
    onPick([(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height])
  }
  return (
    <div class="edited" style={{ aspectRatio: `${SIZE[0]} / ${SIZE[1]}` }}>
      {url ? <img src={url} alt="The model with the changes" class={isOld ? 'waiting' : ''} onClick={pick} /> : null}
      {mask ? <img src={mask} alt="" class="mask" /> : null}
      {isWaiting ? <p class="late"><span class="spinner" />The picture is on its way</p> : null}
    </div>
  )
}

/** Merges one material into another. */
function Merge({ of: { material }, materials, onMerge }: { of: Material; materials: Material[]; onMerge: (into: number) => void }) {
  const others = materials.filter((one) => one.material !== material)
  if (others.length === 0) return null
  return (
    <div>
      <label for="material-into">Merge material {material} into</label>
      <select id="material-into" value="" onChange={(event) => onMerge(Number(event.currentTarget.value))}>
        <option value="" disabled>another material</option>
        {others.map((one) => <option value={one.material} key={one.material}>{one.material}, {(100 * one.share).toFixed(1)} %, {one.colour}</option>)}
      </select>
      <p class="hint">The surface keeps its colours. Later changes of that material apply to both.</p>
    </div>
  )
}

/** The values of one material. */
function Fields({ of: material, edits, onChange }: { of: Material; edits: MaterialEdit[]; onChange: (edits: MaterialEdit[]) => void }) {
  const { colour, roughness, metalness } = valuesOf(material, edits)
  const change = (some: Partial<MaterialValues>) => onChange(changed(edits, material, some))
  const others = undone(edits, material.material)
  const round = (value: number) => Math.round(100 * value) / 100
  return (
    <fieldset class="stack tight">
      <legend>Material {material.material}</legend>
      <div>
        <label for="material-colour">Colour</label>
        <div class="row"><input id="material-colour" type="color" value={colour} onInput={(event) => change({ colour: event.currentTarget.value })} /><span class="small muted">{colour}</span></div>
      </div>
      <Slider label="Roughness" value={round(roughness)} min={0} max={1} step={0.01} unit="" onInput={(roughness) => change({ roughness })} />
      <Slider label="Metalness" value={round(metalness)} min={0} max={1} step={0.01} unit="" onInput={(metalness) => change({ metalness })} />
      <div class="row"><button type="button" disabled={others.length === edits.length} onClick={() => onChange(others)}>Undo</button></div>
    </fieldset>
  )
}
