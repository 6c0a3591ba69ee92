// This file is not run. It must pass `tsc --strict` against the types of the package in web/.
import createClient from 'openapi-fetch';
import type { components, paths } from 'relume-web/api';
import type { RelumeViewer } from 'relume-web/viewer';

const client = createClient<paths>({ baseUrl: 'http://localhost:7878', headers: { Authorization: 'Bearer KEY' } });

export async function relit(upload: string): Promise<ArrayBuffer | string> {
    const capture = await client.POST('/v1/captures', { body: { upload } });
    const id: string | undefined = capture.data?.id;
    if (!id) return capture.error?.title ?? 'no capture';
    const body: components['schemas']['NewJob'] = { capture: id, preset: 'draft', quality_gate: { 'novel_view.psnr': '>=28' } };
    const { data: job, error } = await client.POST('/v1/jobs', { body, params: { header: { 'Idempotency-Key': 'one' } } });
    if (!job) return error.detail ?? error.title;
    const state: 'succeeded' | 'rejected' | 'failed' | 'cancelled' | 'queued' | 'running' | 'cancelling' = job.state;
    const model: string | null | undefined = job.model;
    if (state !== 'succeeded' || !model) return (job.missed ?? []).map((m) => `${m.figure}: ${m.found ?? 'unknown'}`).join();
    const camera = { look_at: { eye: [3, 0, 1.5], target: [0, 0, 0], fov_y_deg: 40 } };
    const frame = { camera, environment: { builtin: 'sunset' }, width: 512, height: 512, outputs: ['rgb', 'normal'] };
    const exr = await client.POST('/v1/models/{id}/render', {
        params: { path: { id: model } }, headers: { Accept: 'image/x-exr' }, body: frame, parseAs: 'arrayBuffer',
    });
    await client.DELETE('/v1/captures/{id}', { params: { path: { id }, query: { cascade: true } } });
    return exr.data ?? 'no frame';
}

export async function shown(): Promise<Blob> {
    const viewer: RelumeViewer = document.createElement('relume-viewer');
    viewer.apiKey = 'KEY';
    viewer.addEventListener('relume-view', (event) => console.log(event.detail.azimuth + event.detail.distance));
    return viewer.snapshot();
}

// None of these calls may compile: tsc reports an unused @ts-expect-error as an error.
export const wrong = [
    // @ts-expect-error a job has no such field
    { capture: 'ID', itterations: 3 } satisfies components['schemas']['NewJob'],
    // @ts-expect-error the response has no such field
    client.GET('/v1/jobs/{id}', { params: { path: { id: 'ID' } } }).then(({ data }) => data?.models),
    // @ts-expect-error there is no such preset
    client.POST('/v1/jobs', { body: { capture: 'ID', preset: 'best' } }),
    // @ts-expect-error a required field is missing
    client.POST('/v1/jobs', { body: { preset: 'draft' } }),
    // @ts-expect-error there is no such path
    client.GET('/v1/photographs', {}),
    // @ts-expect-error the path parameter is missing
    client.GET('/v1/jobs/{id}', {}),
    // @ts-expect-error the viewer has no such property
    document.createElement('relume-viewer').apikey,
];
