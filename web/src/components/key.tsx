import { useEffect, useRef, useState } from 'preact/hooks'
import { onKeyNeeded, setApiKey } from '../api/client'

/** Asks the user for an API key when the server requires one. The browser keeps it until the tab is closed. */
export function KeyDialog() {
  const dialog = useRef<HTMLDialogElement>(null)
  const done = useRef<(() => void) | undefined>(undefined)
  const [again, setAgain] = useState(false)
  useEffect(() => {
    onKeyNeeded(() => new Promise((resolve) => {
      done.current = resolve
      dialog.current?.showModal()
    }))
  }, [])
  const enter = (event: SubmitEvent) => {
    event.preventDefault()
    const form = event.currentTarget as HTMLFormElement
    setApiKey(String(new FormData(form).get('key') ?? '').trim())
    form.reset()
    setAgain(true)
    dialog.current?.close()
    done.current?.()
  }
  return (
    // The user cannot cancel the dialog: without a key the page has nothing to show.
    <dialog ref={dialog} aria-labelledby="key-title" onCancel={(event) => event.preventDefault()}>
      <form onSubmit={enter}>
        <h2 id="key-title">This server asks for a key</h2>
        {again ? <p class="notice bad" role="alert">The key was not accepted. It may be mistyped, revoked or expired.</p> : null}
        <div>
          <label for="key">API key</label>
          <input id="key" name="key" type="password" required autocomplete="off" placeholder="rlm_…" />
        </div>
        <p class="hint">The operator of the server gives you a key; <code>relume keys create --name me</code> makes one. This tab keeps it until you close it and sends it to this server alone.</p>
        <div class="row"><button class="primary" type="submit">Continue</button></div>
      </form>
    </dialog>
  )
}
