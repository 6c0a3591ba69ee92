import { useState } from 'preact/hooks'

interface NumberFieldProps {
  id: string
  label: string
  value: number | undefined
  step: number
  least?: number
  most?: number
  /** Text of the empty field. Without it the field must have a number. */
  empty?: string
  /** Gets numbers, and undefined from an empty field if `empty` is given. */
  onInput: (value: number | undefined) => void
}

/** A field for a number. While it has the focus it keeps the text that was typed. */
export function NumberField({ id, label, value, step, least, most, empty, onInput }: NumberFieldProps) {
  const [draft, setDraft] = useState<string>()
  const typed = (text: string) => {
    setDraft(text)
    const number = text === '' ? NaN : Number(text)
    if (Number.isFinite(number) && (least === undefined || number >= least) && (most === undefined || number <= most)) onInput(number)
    else if (text === '' && empty) onInput(undefined)
  }
  return (
    <div>
      <label for={id}>{label}</label>
      <input id={id} type="number" step={step} {...(least === undefined ? {} : { min: least })} {...(most === undefined ? {} : { max: most })} placeholder={empty ?? ''} value={draft ?? (value === undefined ? '' : String(value))} onInput={(event) => typed(event.currentTarget.value)} onBlur={() => setDraft(undefined)} />
    </div>
  )
}
