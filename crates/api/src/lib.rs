//! Types of the HTTP API that server and client exchange: plain data, without HTTP code.

pub mod calibration;
pub mod cameras;
pub mod captures;
pub mod environments;
pub mod exports;
mod ids;
pub mod jobs;
pub mod keys;
mod lenient;
pub mod materials;
pub mod metadata;
pub mod models;
mod nerfstudio_world;
pub mod next_photographs;
mod page;
pub mod photographs;
pub mod problem;
pub mod quality;
pub mod renders;
mod resources;
pub mod signed_urls;
pub mod uploads;
pub mod usage;
pub mod webhooks;
pub mod work;

pub use ids::{
    CaptureId, DeliveryId, EnvironmentId, ExportId, JobId, KeyId, ModelId, TenantId, UploadId, WebhookId,
    WorkerId,
};
pub use nerfstudio_world::NerfstudioWorld;
pub use page::List;
pub use problem::Problem;
pub use resources::{ResourceKind, ResourceName};
