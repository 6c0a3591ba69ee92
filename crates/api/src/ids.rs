//! Identifiers: one type per kind of resource. They are plain strings in JSON, in URLs and in the database.

macro_rules! identifiers {
    ($($(#[$doc:meta])* $name:ident;)*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
        #[serde(transparent)]
        #[cfg_attr(feature = "sqlx", derive(sqlx::Type), sqlx(transparent))]
        pub struct $name(String);

        impl $name {
            /// The identifier as text.
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl<T: Into<String>> From<T> for $name {
            fn from(text: T) -> Self {
                Self(text.into())
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(&self.0)
            }
        }
    )*};
}

identifiers! {
    /// Identifies a capture.
    CaptureId;
    /// Identifies an uploaded environment map.
    EnvironmentId;
    /// Identifies an export.
    ExportId;
    /// Identifies a job.
    JobId;
    /// Identifies a model.
    ModelId;
    /// Identifies a resumable upload.
    UploadId;
    /// Identifies an API key.
    KeyId;
    /// Identifies a webhook.
    WebhookId;
    /// Identifies a delivery to a webhook.
    DeliveryId;
    /// Identifies a worker.
    WorkerId;
    /// Names a tenant. Callers of one tenant share captures, environments, jobs, models and exports.
    TenantId;
}
