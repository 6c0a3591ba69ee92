import type { components } from './schema'

type Schemas = components['schemas']

export type Capture = Schemas['CaptureView']
export type Report = Schemas['CaptureReport']
export type Cameras = Schemas['CaptureCameras']
export type Camera = Schemas['CapturedCamera']
export type Photographs = Schemas['CapturePhotographs']
export type Photograph = Schemas['CapturedPhotograph']
export type PosesProgress = Schemas['PosesProgress']
export type Upload = Schemas['UploadView']
export type Job = Schemas['JobView']
export type JobState = Schemas['JobState']
export type NewJob = Schemas['NewJob']
export type GreyCard = Schemas['GreyCard']
export type Progress = Schemas['JobProgress']
export type Model = Schemas['ModelView']
export type Material = Schemas['MaterialView']
export type Lamp = Schemas['Lamp']
export type MaterialEdit = Schemas['MaterialEdit']
export type NewCalibration = Schemas['NewCalibration']
export type ModelSummary = Schemas['ModelSummary']
export type Environments = Schemas['EnvironmentList']
export type Environment = Schemas['EnvironmentView']
export type EnvironmentSpec = Schemas['EnvironmentSpec']
export type Export = Schemas['ExportView']
export type NewExport = Schemas['NewExport']
export type DelightExport = Schemas['DelightExport']
export type NextPhotographs = Schemas['NextPhotographs']
export type NextPhotograph = Schemas['NextPhotographView']
export type SignedUrl = Schemas['SignedUrl']
export type Problem = Schemas['Problem']
export type RenderRequest = Schemas['RenderRequest']

/** One page of a list. */
export interface Listed<T> {
  items: T[]
  next?: string | null
}
