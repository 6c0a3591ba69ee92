import { useRef, useState } from 'preact/hooks'
import { ask } from '../api/client'
import { explain, type PageError } from '../api/page-error'
import type { Environment, Environments } from '../api/types'
import { called } from '../format'
import { Failure, Picture } from './common'

/** Selects the light of a model. Each option shows the model under that light. */
export function Lights(props: { model: string; value: string; lights: Environments | undefined; onChange: (light: string) => void; onAdded: () => void }) {
  const [error, setError] = useState<PageError>()
  const [busy, setBusy] = useState(false)
  const input = useRef<HTMLInputElement>(null)
  const uploaded = props.lights?.items ?? []
  const choices = [
    { value: 'recovered', label: 'captured' },
    ...(props.lights?.builtin ?? []).map((name) => ({ value: name, label: name })),
    ...uploaded.map((one) => ({ value: one.id, label: called(one, 'Light') })),
  ]
  const add = async (file: File | null | undefined) => {
    if (!file) return
    setError(undefined)
    setBusy(true)
    try {
      const light = await sendLight(file)
      props.onAdded()
      props.onChange(light.id)
    } catch (failure) {
      setError(explain(failure))
    } finally {
      setBusy(false)
    }
  }
  return (
    <fieldset
      onDragOver={(event) => event.preventDefault()}
      onDrop={(event) => {
        event.preventDefault()
        void add(event.dataTransfer?.files[0])
      }}
    >
      <legend>Light</legend>
      <div class="lights">
        {choices.map(({ value, label }) => (
          <label class="choice" key={value} title={label}>
            <input type="radio" name="light" value={value} checked={value === props.value} onChange={() => props.onChange(value)} />
            <div class="stage"><Picture path={`v1/models/${props.model}/thumbnail?size=96&env=${encodeURIComponent(value)}`} alt="" /></div>
            <span>{label}</span>
          </label>
        ))}
      </div>
      <div class="row" style={{ marginTop: '0.6rem' }}>
        <button type="button" disabled={busy} onClick={() => input.current?.click()}>{busy ? 'Uploading…' : 'Add an HDRI'}</button>
        <span class="hint">or drop a .hdr or .exr here</span>
      </div>
      <input ref={input} type="file" accept=".hdr,.exr" hidden aria-label="HDR environment map" onChange={(event) => void add(event.currentTarget.files?.[0])} />
      <Failure error={error} />
    </fieldset>
  )
}

async function sendLight(file: File): Promise<Environment> {
  const form = new FormData()
  form.append('environment', file)
  const name = encodeURIComponent(file.name.replace(/\.(hdr|exr)$/i, '').slice(0, 200))
  const answer = await ask(`v1/environments?name=${name}`, { method: 'POST', body: form })
  return answer.json() as Promise<Environment>
}
