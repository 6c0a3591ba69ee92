/** The page `docs`: the OpenAPI description of this server, with requests that can be sent and their code. */
import SwaggerUI from 'swagger-ui-dist/swagger-ui-es-bundle.js'
import 'swagger-ui-dist/swagger-ui.css'
import './docs.css'
import { python, typescript, type SnippetRequest } from './snippets'

/** A request of Swagger UI: a map of Immutable.js. */
interface ImmutableRequest {
  toJS(): SnippetRequest
}

SwaggerUI({
  dom_id: '#docs',
  url: './v1/openapi.json',
  deepLinking: true,
  docExpansion: 'list',
  defaultModelsExpandDepth: 0,
  displayRequestDuration: true,
  filter: true,
  tryItOutEnabled: true,
  // The key stays in this page; it is gone when the page is closed.
  persistAuthorization: false,
  // No request to a validator on the network.
  validatorUrl: null,
  requestSnippetsEnabled: true,
  requestSnippets: {
    defaultExpanded: true,
    languages: ['curl_bash', 'python', 'typescript'],
    generators: {
      curl_bash: { title: 'curl', syntax: 'bash' },
      python: { title: 'Python', syntax: 'python' },
      typescript: { title: 'TypeScript', syntax: 'javascript' },
    },
  },
  plugins: [
    {
      fn: {
        requestSnippetGenerator_python: (request: ImmutableRequest) => python(request.toJS()),
        requestSnippetGenerator_typescript: (request: ImmutableRequest) => typescript(request.toJS()),
      },
    },
  ],
})
