import type { ComponentChildren } from 'preact'
import { useEffect, useRef, useState } from 'preact/hooks'
import { explain, GONE, type PageError } from '../api/page-error'
import { usePicture } from '../hooks'
import { release } from '../object-url'

/** An image from an API path. */
export function Picture({ path, alt }: { path: string | undefined; alt: string }) {
  const url = usePicture(path)
  return url ? <img src={url} alt={alt} /> : null
}

export function Badge({ state }: { state: string }) {
  return <span class={`badge ${state}`}>{state}</span>
}

/** An error, which screen readers announce immediately: what happened, what to do, and the server's own message behind *Details*. */
export function Failure({ error, retry }: { error: PageError | undefined; retry?: () => void }) {
  return (
    <div role="alert">
      {error ? (
        <div class="notice bad stack tight">
          <p><strong>{error.what}</strong>{error.remedy ? ` ${error.remedy}` : ''}</p>
          {error.detail ? <details><summary>Details</summary><p class="said small">{error.detail}</p></details> : null}
          {retry ? <div class="row"><button type="button" onClick={retry}>Try again</button></div> : null}
        </div>
      ) : null}
    </div>
  )
}

/** The content of a page whose resource could not be loaded. */
export function Missing(props: { what: string; back: { to: string; label: string }; error: PageError; retry: () => void }) {
  const isGone = props.error.what === GONE
  const error = isGone ? { ...props.error, what: `This server has no such ${props.what}.` } : props.error
  return (
    <>
      <Head title={isGone ? `No such ${props.what}` : `The ${props.what} is not shown`} back={props.back} />
      <div class="stack">
        <Failure error={error} {...(isGone ? {} : { retry: props.retry })} />
        <p><a class="button" href={props.back.to}>Show all {props.back.label.toLowerCase()}</a></p>
      </div>
    </>
  )
}

interface HeadProps {
  title: string
  back?: { to: string; label: string }
  badge?: string | undefined
  note?: ComponentChildren
  /** Stores a new name. Without it the title cannot be changed. */
  rename?: ((name: string) => Promise<unknown>) | undefined
  children?: ComponentChildren
}

/** The header of a page. */
export function Head(props: HeadProps) {
  return (
    <header class="head">
      <div>
        {props.back ? <a class="crumb" href={props.back.to}>← {props.back.label}</a> : null}
        <div class="row">{props.rename ? <Named title={props.title} rename={props.rename} /> : <h1>{props.title}</h1>}{props.badge ? <Badge state={props.badge} /> : null}</div>
        {props.note ? <p>{props.note}</p> : null}
      </div>
      {props.children ? <div class="row" style={{ flex: '0 1 auto' }}>{props.children}</div> : null}
    </header>
  )
}

/** A title that the user can change in place. */
function Named({ title, rename }: { title: string; rename: (name: string) => Promise<unknown> }) {
  const [draft, setDraft] = useState<string>()
  const [error, setError] = useState<PageError>()
  const input = useRef<HTMLInputElement>(null)
  const isEditing = draft !== undefined
  useEffect(() => input.current?.select(), [isEditing])
  const store = (event: SubmitEvent) => {
    event.preventDefault()
    const name = draft?.trim()
    if (!name || name === title) return setDraft(undefined)
    rename(name).then(() => {
      setError(undefined)
      setDraft(undefined)
    }, (failure: unknown) => setError(explain(failure)))
  }
  if (!isEditing) return <><h1>{title}</h1><button type="button" class="quiet" onClick={() => setDraft(title)}>Rename</button></>
  return (
    <form class="row naming" onSubmit={store} onKeyDown={(event) => event.key === 'Escape' && setDraft(undefined)}>
      <h1 class="skip">{title}</h1>
      <input aria-label="Name" value={draft} maxLength={200} ref={input} onInput={(event) => setDraft(event.currentTarget.value)} />
      <button type="submit" class="primary">Save the name</button>
      <button type="button" class="quiet" onClick={() => setDraft(undefined)}>Keep the old one</button>
      <Failure error={error} />
    </form>
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
  release(url)
}
