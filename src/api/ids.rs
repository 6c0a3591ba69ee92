//! Identifiers, one type for each kind of resource. In JSON, in URLs and in the database they are plain strings.

macro_rules! identifiers {
    ($($(#[$doc:meta])* $name:ident;)*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
        #[serde(transparent)]
        #[cfg_attr(feature = "server", derive(sqlx::Type), sqlx(transparent))]
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
    /// Identifies an upload that arrives in pieces.
    UploadId;
    /// Identifies an API key.
    KeyId;
    /// Identifies a webhook.
    WebhookId;
    /// Identifies a message to a webhook.
    DeliveryId;
    /// Identifies a worker.
    WorkerId;
    /// Names a tenant: those who share captures, environments, jobs and models.
    TenantId;
}
