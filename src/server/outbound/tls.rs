//! Outbound TLS with the certificate authorities of this machine.

use std::sync::Arc;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::OnceCell;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

/// The TLS configuration, which is read from the machine at its first use.
#[derive(Default)]
pub(in crate::server) struct Tls {
    config: OnceCell<Arc<ClientConfig>>,
}

impl Tls {
    /// Starts TLS on a connection to `host`.
    ///
    /// # Errors
    /// The reason of the failure.
    pub(in crate::server) async fn over<S>(&self, stream: S, host: &str) -> Result<TlsStream<S>, String>
    where
        S: AsyncRead + AsyncWrite + Unpin,
    {
        let config = self.config.get_or_try_init(load).await?.clone();
        let name =
            ServerName::try_from(host.to_owned()).map_err(|_| "its host is not a valid TLS server name")?;
        let connected = tokio_rustls::TlsConnector::from(config).connect(name, stream).await;
        connected.map_err(|error| format!("the TLS handshake failed: {error}"))
    }
}

async fn load() -> Result<Arc<ClientConfig>, String> {
    let found = tokio::task::spawn_blocking(rustls_native_certs::load_native_certs).await;
    let found = found.map_err(|error| error.to_string())?;
    for error in &found.errors {
        tracing::warn!(%error, "cannot read the certificate authorities");
    }
    let mut roots = RootCertStore::empty();
    roots.add_parsable_certificates(found.certs);
    if roots.is_empty() {
        return Err("this server has no certificate authorities (install ca-certificates)".to_owned());
    }
    let config = ClientConfig::builder_with_provider(Arc::new(default_provider()));
    let config = config.with_safe_default_protocol_versions().map_err(|error| error.to_string())?;
    Ok(Arc::new(config.with_root_certificates(roots).with_no_client_auth()))
}
