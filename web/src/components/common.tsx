import type { ComponentChildren } from 'preact'
import { usePicture } from '../hooks'

/** An image from an API path. */
export function Picture({ path, alt }: { path: string | undefined; alt: string }) {
  const url = usePicture(path)
  return url ? <img src={url} alt={alt} /> : null
}

export function Badge({ state }: { state: string }) {
  return <span class={`badge ${state}`}>{state}</span>
}

/** An error message, which screen readers announce immediately. */
export function Failure({ error }: { error: string | undefined }) {
  return <div role="alert">{error ? <p class="notice bad">{error}</p> : null}</div>
}

/** The header of a page. */
export function Head(props: { title: string; back?: { to: string; label: string }; badge?: string | undefined; note?: ComponentChildren; children?: ComponentChildren }) {
  return (
    <header class="head">
      <div>
        {props.back ? <a class="crumb" href={props.back.to}>← {props.back.label}</a> : null}
        <div class="row"><h1>{props.title}</h1>{props.badge ? <Badge state={props.badge} /> : null}</div>
        {props.note ? <p>{props.note}</p> : null}
      </div>
      {props.children ? <div class="row" style={{ flex: '0 1 auto' }}>{props.children}</div> : null}
    </header>
  )
}

/** A list of names and values. */
export function Facts({ of }: { of: [string, ComponentChildren][] }) {
  return <dl class="facts">{of.map(([name, value]) => <div key={name}><dt>{name}</dt><dd>{value}</dd></div>)}</dl>
}

/** A radio group of buttons. */
export function Choices(props: { legend: string; name: string; value: string; of: { value: string; label: string; hint?: string }[]; onChange: (value: string) => void; pills?: boolean }) {
  return (
    <fieldset>
      <legend>{props.legend}</legend>
      <div class={props.pills ? 'pills' : 'choices'}>
        {props.of.map(({ value, label, hint }) => (
          <label class="choice" key={value}>
            <input type="radio" name={props.name} value={value} checked={value === props.value} onChange={() => props.onChange(value)} />
            {label}
            {hint ? <span class="hint">{hint}</span> : null}
          </label>
        ))}
      </div>
    </fieldset>
  )
}

/** A slider that shows its value. */
export function Slider(props: { label: string; value: number; min: number; max: number; step: number; unit: string; onInput: (value: number) => void }) {
  const id = `slider-${props.label.toLowerCase().replace(/\W+/g, '-')}`
  return (
    <div class="ranged">
      <label for={id}>{props.label}</label>
      <output for={id}>{props.value}{props.unit}</output>
      <input id={id} type="range" min={props.min} max={props.max} step={props.step} value={props.value} onInput={(event) => props.onInput(Number(event.currentTarget.value))} />
    </div>
  )
}

/** Saves a blob as a download. */
export function save(blob: Blob, name: string): void {
  const url = URL.createObjectURL(blob)
  const anchor = Object.assign(document.createElement('a'), { href: url, download: name })
  anchor.click()
  setTimeout(() => URL.revokeObjectURL(url), 10_000)
}
