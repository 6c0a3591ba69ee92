import type { Listed, ModelSummary } from '../api/types'
import { Failure, Head, Picture } from '../components/common'
import { called, count, moment } from '../format'
import { useLoaded, useTitle } from '../hooks'
import { link } from '../router'

export function ModelsPage() {
  useTitle('Models')
  const models = useLoaded<Listed<ModelSummary>>('v1/models?limit=60')
  const items = models.data?.items
  return (
    <>
      <Head title="Models" note="Relightable: shown from any side, under any light." />
      <Failure error={models.error} />
      {items && !items.length ? <p class="card empty">No models yet. <a href={link(['captures'])}>Add a capture</a> and train one.</p> : null}
      <ul class="tiles">
        {items?.map((model) => (
          <li class="tile" key={model.id}>
            <div class="stage"><Picture path={`v1/models/${model.id}/thumbnail?size=320&env=studio`} alt="" /></div>
            <div class="text">
              <a class="over" href={link(['models', model.id])}>{called(model, 'Model')}</a>
              <p class="muted small">{count(model.gaussians)} Gaussians · {moment(model.created_at)}</p>
            </div>
          </li>
        ))}
      </ul>
    </>
  )
}
