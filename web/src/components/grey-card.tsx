import { useState } from 'preact/hooks'
import type { GreyCard } from '../api/types'
import { PatchPicker, type Patch } from './patch-picker'

/** Surfaces whose reflectance is known. Without it, the surface tells only the colour of the light. */
const SURFACES = [
  ['0.18', 'Grey card (18 %)'],
  ['0.85', 'White paper (about 85 %)'],
  ['', 'Another white or grey thing'],
] as const

/** Chooses the patch of a photograph that shows a grey or white surface. */
export function GreyCardPatch({ capture, value, onChange }: { capture: string; value: GreyCard | undefined; onChange: (card: GreyCard | undefined) => void }) {
  const [reflectance, setReflectance] = useState('0.18')
  const card = ({ photo, x, y, width, height }: Patch, text: string) => ({ photo, x, y, width, height, ...(text ? { reflectance: Number(text) } : {}) })
  return (
    <PatchPicker id="card" capture={capture} heldOut={false} legend="Click on the grey or white surface, where all of the light reaches it" value={value} onChange={(patch) => onChange(patch && card(patch, reflectance))}>
      <div>
        <label for="card-surface">Surface</label>
        <select id="card-surface" value={reflectance} onChange={(event) => {
          const text = event.currentTarget.value
          setReflectance(text)
          if (value) onChange(card(value, text))
        }}>{SURFACES.map(([text, label]) => <option key={text} value={text}>{label}</option>)}</select>
      </div>
    </PatchPicker>
  )
}
