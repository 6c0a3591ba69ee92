import { useState } from 'preact/hooks'
import type { Environments } from '../api/types'
import { called } from '../format'
import type { View } from '../look'
import { Picture } from './common'

/** The model under every light, from the direction of the current view. */
export function LightComparison({ model, view, lights, onChange }: { model: string; view: View | undefined; lights: Environments | undefined; onChange: (light: string) => void }) {
  const [shown, setShown] = useState<{ azimuth: number; elevation: number }>()
  const all = [['recovered', 'captured'], ...(lights?.builtin ?? []).map((name) => [name, name]), ...(lights?.items ?? []).map((one) => [one.id, called(one, 'Light')])] as [string, string][]
  const show = () => view && setShown({ azimuth: Math.round(view.azimuth), elevation: Math.round(view.elevation) })
  return (
    <section class="card stack" aria-labelledby="side">
      <h2 id="side">Lights side by side</h2>
      <div class="row">
        <button type="button" disabled={!view} onClick={show}>{shown ? 'Show from the current direction' : 'Show the model in every light'}</button>
        {shown ? <button type="button" class="quiet" onClick={() => setShown(undefined)}>Hide</button> : null}
      </div>
      {shown ? (
        <div class="side">
          {all.map(([value, label]) => (
            <button type="button" key={value} onClick={() => onChange(value)} aria-label={`Choose the light ${label}`}>
              <Picture path={`v1/models/${model}/thumbnail?size=320&env=${encodeURIComponent(value)}&azimuth=${shown.azimuth}&elevation=${shown.elevation}`} alt="" />
              <span>{label}</span>
            </button>
          ))}
        </div>
      ) : null}
    </section>
  )
}
