import { useState } from 'preact/hooks'
import type { GreyCard, Photographs } from '../api/types'
import { useLoaded } from '../hooks'
import { Failure, Picture } from './common'

/** Side of a patch that a click chooses, as a share of the longest side of the photograph, and its least side in pixels. */
const SHARE = 0.03
const LEAST = 4

/** Surfaces whose reflectance is known. Without it, the surface tells only the colour of the light. */
const SURFACES = [
  ['0.18', 'Grey card (18 %)'],
  ['0.85', 'White paper (about 85 %)'],
  ['', 'Another white or grey thing'],
] as const

/** Chooses the patch of a photograph that shows a grey or white surface: by a click, or by numbers. */
export function GreyCardPatch({ capture, value, onChange }: { capture: string; value: GreyCard | undefined; onChange: (card: GreyCard | undefined) => void }) {
  const taken = useLoaded<Photographs>(`v1/captures/${encodeURIComponent(capture)}/photographs`)
  const [name, setName] = useState<string>()
  const [reflectance, setReflectance] = useState('0.18')
  const photographs = (taken.data?.photographs ?? []).filter(({ held_out }) => !held_out)
  const photograph = photographs.find((one) => one.name === name) ?? photographs[0]
  if (!photograph) return <Failure error={taken.error} retry={taken.reload} />
  const { width, height, href } = photograph
  const known = (text: string) => (text ? { reflectance: Number(text) } : {})
  const set = (x: number, y: number, side: number) => {
    const size = Math.min(Math.max(1, side), width, height)
    const inside = (at: number, most: number) => Math.min(Math.max(0, Math.round(at)), most - size)
    onChange({ photo: photograph.name, x: inside(x, width), y: inside(y, height), width: size, height: size, ...known(reflectance) })
  }
  const click = (event: MouseEvent) => {
    const box = (event.currentTarget as HTMLElement).getBoundingClientRect()
    const side = Math.max(LEAST, Math.round(SHARE * Math.max(width, height)))
    set(((event.clientX - box.left) / box.width) * width - side / 2, ((event.clientY - box.top) / box.height) * height - side / 2, side)
  }
  const percent = (part: number, whole: number) => `${(100 * part) / whole}%`
  return (
    <fieldset class="stack">
      <legend>Click on the grey or white surface, where all of the light reaches it</legend>
      <div class="fields">
        <div>
          <label for="card-photo">Photograph with the surface</label>
          <select id="card-photo" value={photograph.name} onChange={(event) => {
            setName(event.currentTarget.value)
            onChange(undefined)
          }}>{photographs.map((one) => <option key={one.name} value={one.name}>{one.name}</option>)}</select>
        </div>
        <div>
          <label for="card-surface">Surface</label>
          <select id="card-surface" value={reflectance} onChange={(event) => {
            const text = event.currentTarget.value
            setReflectance(text)
            if (value) onChange({ photo: value.photo, x: value.x, y: value.y, width: value.width, height: value.height, ...known(text) })
          }}>{SURFACES.map(([text, label]) => <option key={text} value={text}>{label}</option>)}</select>
        </div>
      </div>
      <div class="patch" onClick={click}>
        <Picture path={`${href}?width=${Math.min(width, 800)}`} alt={`Photograph ${photograph.name}`} />
        {value ? <span style={{ left: percent(value.x, width), top: percent(value.y, height), width: percent(value.width, width), height: percent(value.height, height) }} /> : null}
      </div>
      <details>
        <summary>Details: the patch in pixels</summary>
        <div class="fields">
          <Pixels id="card-x" label="Left" value={value?.x ?? 0} onInput={(x) => set(x, value?.y ?? 0, value?.width ?? LEAST)} />
          <Pixels id="card-y" label="Top" value={value?.y ?? 0} onInput={(y) => set(value?.x ?? 0, y, value?.width ?? LEAST)} />
          <Pixels id="card-side" label="Side" value={value?.width ?? LEAST} onInput={(side) => set(value?.x ?? 0, value?.y ?? 0, side)} />
        </div>
      </details>
    </fieldset>
  )
}

function Pixels({ id, label, value, onInput }: { id: string; label: string; value: number; onInput: (value: number) => void }) {
  return <div><label for={id}>{label}</label><input id={id} type="number" min={0} step={1} value={value} onChange={(event) => onInput(Number(event.currentTarget.value))} /></div>
}
