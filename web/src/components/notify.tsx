import { useEffect, useState } from 'preact/hooks'

/** Offers a notification of the browser for the end of a work. The browser asks the user for permission after the click. */
export function Notify({ isOver, text }: { isOver: boolean; text: string }) {
  const [state, setState] = useState<'off' | 'on' | 'denied'>('off')
  useEffect(() => {
    if (isOver && state === 'on') {
      new Notification('Relume', { body: text })
      setState('off')
    }
  }, [isOver, state, text])
  // Browsers offer notifications only on localhost and over https. On Android a page alone cannot show one: the constructor throws.
  if (isOver || !('Notification' in window) || !window.isSecureContext || /Android/.test(navigator.userAgent)) return null
  const ask = async () => setState((await Notification.requestPermission()) === 'granted' ? 'on' : 'denied')
  if (state === 'off') return <div class="row"><button type="button" onClick={() => void ask()}>Notify me when it is done</button></div>
  return <span class="hint" role="status">{state === 'on' ? 'The browser tells you when it is done, while this tab stays open.' : 'The browser does not allow notifications of this page. Its settings can change that.'}</span>
}
