//! The folder that a peer has its keys in.

use super::{Peer, Signer};
use anyhow::{Context, Result, anyhow, bail};
use ring::signature::Ed25519KeyPair;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivatePkcs8KeyDer, UnixTime};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::sync::Arc;
use std::time::SystemTime;
use webpki::{EndEntityCert, KeyUsage, anchor_from_trusted_cert};

/// The authority's certificate, in its own folder and in every peer's.
pub const AUTHORITY: &str = "authority.crt";
/// A peer's certificate.
pub const CERTIFICATE: &str = "agent.crt";
/// Its private key.
pub const KEY: &str = "agent.key";
const HINT: &str = "hint: `loopbox keys agent NAME --authority DIR --out DIR` makes such a folder";

/// A peer's certificate with its key, and the authority by which others are believed.
#[derive(Clone)]
pub struct Keys {
    pub(crate) authority: CertificateDer<'static>,
    pub(crate) certificate: CertificateDer<'static>,
    pub(crate) key: Arc<PrivatePkcs8KeyDer<'static>>,
    signer: Arc<Signer>,
}

impl Keys {
    /// Reads the folder that `loopbox keys agent` made.
    ///
    /// # Errors
    /// When a file is not there or not what it should be, or others of this machine can read the private key.
    pub fn open(folder: &Path) -> Result<Self> {
        let certificate = read_certificate(&folder.join(CERTIFICATE))?;
        let authority = read_certificate(&folder.join(AUTHORITY))?;
        let path = folder.join(KEY);
        let key = read_key(&path)?;
        let of_certificate = || folder.join(CERTIFICATE).display().to_string();
        let peer = Peer::of_certificate(&certificate).map_err(|what| {
            anyhow!("{}: cannot be used as a certificate: {what}\n{HINT}", of_certificate())
        })?;
        let pair = Ed25519KeyPair::from_pkcs8_maybe_unchecked(key.secret_pkcs8_der())
            .map_err(|error| anyhow!("{}: is no private key of Ed25519: {error}\n{HINT}", path.display()))?;
        if ring::signature::KeyPair::public_key(&pair).as_ref() != peer.key {
            bail!("{}: is not the key of {}\n{HINT}", path.display(), of_certificate());
        }
        let signer = Arc::new(Signer { peer, key: pair });
        Ok(Self { authority, certificate, key: Arc::new(key), signer })
    }

    /// Whether others will believe the certificate now.
    ///
    /// # Errors
    /// When they will not, with the reason.
    pub fn check(&self, now: SystemTime) -> Result<(), String> {
        let refuse = |error: webpki::Error| match error {
            webpki::Error::CertExpired { .. } => "it has expired".to_owned(),
            webpki::Error::CertNotValidYet { .. } => "it is not valid yet: is the clock right?".to_owned(),
            webpki::Error::UnknownIssuer | webpki::Error::InvalidSignatureForPublicKey => {
                format!("it is not of the authority whose {AUTHORITY} lies beside it")
            }
            other => other.to_string(),
        };
        let anchor = [anchor_from_trusted_cert(&self.authority).map_err(refuse)?];
        let since = now.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let algorithms = rustls::crypto::ring::default_provider().signature_verification_algorithms.all;
        let certificate = EndEntityCert::try_from(&self.certificate).map_err(refuse)?;
        let (now, usage) = (UnixTime::since_unix_epoch(since), KeyUsage::client_auth());
        certificate.verify_for_usage(algorithms, &anchor, &[], now, usage, None, None).map_err(refuse)?;
        Ok(())
    }

    /// Whose they are.
    pub fn peer(&self) -> &Peer {
        self.signer.peer()
    }

    /// Signs what the peer tells.
    pub fn signer(&self) -> Arc<Signer> {
        Arc::clone(&self.signer)
    }
}

impl std::fmt::Debug for Keys {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Keys({})", self.peer().name)
    }
}

/// A certificate.
pub(super) fn read_certificate(path: &Path) -> Result<CertificateDer<'static>> {
    let bytes = read(path)?;
    CertificateDer::from_pem_slice(&bytes)
        .map_err(|error| anyhow!("{}: is no certificate in PEM: {error}\n{HINT}", path.display()))
}

/// A private key, that nobody else can read.
pub(super) fn read_key(path: &Path) -> Result<PrivatePkcs8KeyDer<'static>> {
    let bytes = read(path)?;
    let mode = fs::metadata(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    if mode.permissions().mode() & 0o077 != 0 {
        bail!(
            "{}: others on this machine can read this private key\nhint: chmod 600 {}",
            path.display(),
            path.display()
        );
    }
    PrivatePkcs8KeyDer::from_pem_slice(&bytes)
        .map_err(|error| anyhow!("{}: is no private key in PEM: {error}\n{HINT}", path.display()))
}

fn read(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).with_context(|| format!("{}: cannot be read\n{HINT}", path.display()))
}
