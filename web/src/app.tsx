import { Head } from './components/common'
import { KeyDialog } from './components/key'
import { Theme } from './components/theme'
import { CapturePage } from './pages/capture'
import { CapturesPage } from './pages/captures'
import { ComparePage } from './pages/compare'
import { JobPage } from './pages/job'
import { JobsPage } from './pages/jobs'
import { ModelPage } from './pages/model'
import { ModelsPage } from './pages/models'
import { useTitle } from './hooks'
import { link, usePlace, type Place } from './router'

const SECTIONS = [['captures', 'Captures'], ['jobs', 'Jobs'], ['models', 'Models']] as const

export function App() {
  const place = usePlace()
  const section = place.path[0] === 'compare' ? 'jobs' : place.path[0] ?? 'captures'
  return (
    <div class="shell">
      <header class="top">
        <button type="button" class="skip" onClick={() => document.getElementById('main')?.focus()}>Skip to the content</button>
        <a class="brand" href={link(['captures'])}><img src="./favicon.svg" alt="" />Relume</a>
        <nav aria-label="Sections">
          <ul>{SECTIONS.map(([name, label]) => <li key={name}><a href={link([name])} aria-current={name === section ? 'page' : undefined}>{label}</a></li>)}</ul>
        </nav>
        <div class="end"><a href="./docs">API</a><Theme /></div>
      </header>
      <main id="main" tabIndex={-1}><Page at={place} /></main>
      <KeyDialog />
    </div>
  )
}

function Page({ at: { path: [section = 'captures', id], query } }: { at: Place }) {
  switch (section) {
    case 'captures':
      return id ? <CapturePage key={id} id={id} /> : <CapturesPage />
    case 'jobs':
      return id ? <JobPage key={id} id={id} /> : <JobsPage capture={query.get('capture')} />
    case 'compare':
      return <ComparePage a={query.get('a') ?? ''} b={query.get('b') ?? ''} />
    case 'models':
      return id ? <ModelPage key={id} id={id} query={query} /> : <ModelsPage />
    default:
      return <NoPage />
  }
}

function NoPage() {
  useTitle('No such page')
  return (
    <>
      <Head title="There is no such page" note="The link is incomplete, or it is for another server." />
      <p class="row"><a class="button primary" href={link(['captures'])}>Captures</a><a class="button" href={link(['models'])}>Models</a></p>
    </>
  )
}
