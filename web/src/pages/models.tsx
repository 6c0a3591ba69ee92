import type { Listed, ModelSummary } from '../api/types'
import { Failure, Head, Picture } from '../components/common'
import { called, moment } from '../format'
import { useLoaded, useTitle } from '../hooks'
import { link } from '../router'

export function ModelsPage() {
  useTitle('Models')
  const models = useLoaded<Listed<ModelSummary>>('v1/models?limit=60')
  const items = models.data?.items
  return (
    <>
      <Head title="Models" note="Look at a model from any side, in any light." />
      <Failure error={models.error} retry={models.reload} />
      {items && !items.length ? <p class="card empty">No models yet. <a href={link(['captures'])}>Add photographs, or try the sample</a>, and train one.</p> : null}
      <ul class="tiles">
        {items?.map((model) => (
          <li class="tile" key={model.id}>
            <div class="stage"><Picture path={`v1/models/${model.id}/thumbnail?size=320&env=studio`} alt="" /></div>
            <div class="text">
              <a class="over" href={link(['models', model.id])}>{called(model, 'Model')}</a>
              <p class="muted small">{moment(model.created_at)}</p>
            </div>
          </li>
        ))}
      </ul>
    </>
  )
}
