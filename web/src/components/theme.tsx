import { useEffect, useState } from 'preact/hooks'

const STORED = 'relume-theme'
const NEXT: Record<string, string> = { auto: 'light', light: 'dark', dark: 'auto' }

/** Selects the colour scheme: light, dark or the system's. */
export function Theme() {
  const [theme, setTheme] = useState(() => localStorage.getItem(STORED) ?? 'auto')
  useEffect(() => {
    localStorage.setItem(STORED, theme)
    if (theme === 'auto') delete document.documentElement.dataset.theme
    else document.documentElement.dataset.theme = theme
  }, [theme])
  return <button type="button" class="quiet" onClick={() => setTheme(NEXT[theme] ?? 'auto')} aria-label={`Colours: ${theme}`}>{{ auto: '◐ Auto', light: '○ Light', dark: '● Dark' }[theme]}</button>
}
