//! TLS 1.3 between two peers of one fleet: each shows a certificate of the authority that both know.

use crate::keys::{EVERY_PEER, Keys, Peer};
use anyhow::{Context, Result};
use rustls::client::Resumption;
use rustls::crypto::ring::default_provider;
use rustls::pki_types::{PrivateKeyDer, ServerName};
use rustls::server::WebPkiClientVerifier;
use rustls::version::TLS13;
use rustls::{
    AlertDescription, CertificateError, ClientConfig, ClientConnection, Connection, RootCertStore,
    ServerConfig, ServerConnection,
};
use std::io::{self, ErrorKind, Read};
use std::net::{Shutdown, TcpStream};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How long two may take to show each other who they are.
const PATIENCE: Duration = Duration::from_secs(10);
/// How long, and of how much, what the other one still sends is read after it was refused: else the system throws away
/// why.
const FAREWELL: (Duration, usize) = (Duration::from_secs(1), 1 << 18);

/// Which end of a connection this one is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    Dialled,
    Accepted,
}

/// Opens connections.
pub(super) struct Tls {
    client: Arc<ClientConfig>,
    server: Arc<ServerConfig>,
    everyone: ServerName<'static>,
}

impl Tls {
    /// With a peer's keys.
    ///
    /// # Errors
    /// When they cannot be used.
    pub fn new(keys: &Keys) -> Result<Self> {
        let mut roots = RootCertStore::empty();
        roots.add(keys.authority.clone()).context("the authority's certificate cannot be used")?;
        let (roots, provider) = (Arc::new(roots), Arc::new(default_provider()));
        let key = || PrivateKeyDer::Pkcs8(keys.key.clone_key());
        let chain = || vec![keys.certificate.clone()];
        let mut client = ClientConfig::builder_with_provider(Arc::clone(&provider))
            .with_protocol_versions(&[&TLS13])?
            .with_root_certificates(Arc::clone(&roots))
            .with_client_auth_cert(chain(), key())?;
        // Whoever comes back shows its certificate again: it may have expired.
        client.resumption = Resumption::disabled();
        let verifier = WebPkiClientVerifier::builder_with_provider(roots, Arc::clone(&provider)).build()?;
        let mut server = ServerConfig::builder_with_provider(provider)
            .with_protocol_versions(&[&TLS13])?
            .with_client_cert_verifier(verifier)
            .with_single_cert(chain(), key())?;
        server.send_tls13_tickets = 0;
        let everyone = ServerName::try_from(EVERY_PEER).context("the parties' common name")?;
        Ok(Self { client: Arc::new(client), server: Arc::new(server), everyone })
    }

    /// Shows each other who one is, on a stream whose reads and writes give up after a while; ends early once it
    /// `ends`.
    ///
    /// # Errors
    /// When the other one is not to be believed, or does not believe this one.
    pub fn shake(
        &self,
        stream: &TcpStream,
        side: Side,
        ends: impl Fn() -> bool,
    ) -> io::Result<(Connection, Peer)> {
        let session = match side {
            Side::Dialled => {
                ClientConnection::new(Arc::clone(&self.client), self.everyone.clone()).map(Connection::from)
            }
            Side::Accepted => ServerConnection::new(Arc::clone(&self.server)).map(Connection::from),
        };
        let mut session = session.map_err(broken)?;
        let until = Instant::now() + PATIENCE;
        while session.is_handshaking() || session.wants_write() {
            if Instant::now() > until || ends() {
                return Err(io::Error::new(ErrorKind::TimedOut, "it does not show who it is"));
            }
            let step = match session.wants_write() {
                true => session.write_tls(&mut &*stream),
                false => session.read_tls(&mut &*stream),
            };
            match step {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(_) => {}
                Err(error) if super::is_patience(&error) => continue,
                Err(error) => return Err(error),
            }
            if let Err(error) = session.process_new_packets() {
                close_after_alert(&mut session, stream);
                return Err(broken(error));
            }
        }
        let presented = session.peer_certificates().and_then(|chain| chain.first());
        let peer = presented.map_or_else(|| Err("it shows none".into()), |der| Peer::of_certificate(der));
        let peer = peer.map_err(|what| {
            io::Error::new(ErrorKind::InvalidData, format!("its certificate cannot be used: {what}"))
        })?;
        Ok((session, peer))
    }
}

/// Tells the other one why it is refused, and waits until it may have read that.
fn close_after_alert(session: &mut Connection, stream: &TcpStream) {
    // Whatever fails, the connection ends.
    while session.wants_write() && session.write_tls(&mut &*stream).is_ok() {}
    let _ = stream.shutdown(Shutdown::Write);
    let (until, mut left) = (Instant::now() + FAREWELL.0, FAREWELL.1);
    let mut rest = [0; 4096];
    while Instant::now() < until && left > 0 {
        match (&*stream).read(&mut rest) {
            Ok(0) => return,
            Ok(count) => left = left.saturating_sub(count),
            Err(error) if super::is_patience(&error) => {}
            Err(_) => return,
        }
    }
}

/// What went wrong between two ends, as an error of the stream.
pub(super) fn broken(error: rustls::Error) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, error)
}

/// Why a connection with `place` broke, if it is more than that it ended.
pub(super) fn disconnect_reason(place: &str, error: &io::Error) -> Option<String> {
    let inner = error.get_ref()?;
    let Some(error) = inner.downcast_ref::<rustls::Error>() else {
        return Some(format!("{place} is refused: {inner}"));
    };
    use rustls::Error as Tls;
    let refused = |what: &str| Some(format!("{place} is refused: {what}"));
    match error {
        Tls::AlertReceived(alert) => {
            let what = match alert {
                AlertDescription::CertificateExpired => "by its clock our certificate has expired".into(),
                AlertDescription::UnknownCA | AlertDescription::DecryptError => {
                    "its authority is not the one of our certificate".into()
                }
                AlertDescription::CertificateRequired => "it asks for a certificate".into(),
                AlertDescription::CloseNotify => return None,
                other => format!("it says {other:?}"),
            };
            Some(format!("{place} refused us: {what}"))
        }
        Tls::NoCertificatesPresented => refused("it shows no certificate"),
        Tls::InvalidCertificate(what) => match what {
            CertificateError::Expired | CertificateError::ExpiredContext { .. } => {
                refused("its certificate has expired")
            }
            CertificateError::NotValidYet | CertificateError::NotValidYetContext { .. } => {
                refused("its certificate is not valid yet: are both clocks right?")
            }
            CertificateError::UnknownIssuer | CertificateError::BadSignature => {
                refused("its certificate is of another authority")
            }
            other => refused(&format!("its certificate cannot be used: {other}")),
        },
        Tls::InvalidMessage(_) => refused("it speaks no TLS: does it dial tcp/ instead of tls/?"),
        other => refused(&other.to_string()),
    }
}
