//! Certificates made: an authority of one's own, and by it certificates of peers.

use super::files::{AUTHORITY, CERTIFICATE, KEY, read_certificate, read_key};
use super::{EVERY_PEER, MAX_PEER_NAME, Peer, is_peer_name};
use anyhow::{Context, Result, anyhow, bail};
use map::Uuid;
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose, PKCS_ED25519, SanType,
};
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::{Duration, SystemTime};

/// The authority's private key.
const AUTHORITY_KEY: &str = "authority.key";
const DAY: Duration = Duration::from_secs(24 * 3600);
/// How long an authority is valid.
const AUTHORITY_DAYS: u32 = 3650;
/// How long a peer's certificate is valid, if nothing else is said.
pub const DAYS: u32 = 825;
/// Most days: later times do not fit into a certificate's form.
const MOST_DAYS: u32 = 36_500;

/// From when to when a certificate is valid.
#[derive(Clone, Copy, Debug)]
pub struct Validity {
    /// From then on.
    pub from: SystemTime,
    /// Not any more after that.
    pub until: SystemTime,
}

impl Validity {
    /// So many days from now on, and a day back: clocks differ.
    ///
    /// # Errors
    /// When it is no number of days that a certificate can be valid for.
    pub fn days(days: u32) -> Result<Self> {
        if !(1..=MOST_DAYS).contains(&days) {
            bail!("--days {days}: a certificate is valid for 1 to {MOST_DAYS} days\nhint: {DAYS} is usual");
        }
        let now = SystemTime::now();
        Ok(Self { from: now - DAY, until: now + days * DAY })
    }
}

/// Makes certificates for the peers of a fleet.
pub struct Authority {
    issuer: Issuer<'static, KeyPair>,
    certificate: String,
    /// Of which the peers' UUIDs are made.
    namespace: Uuid,
}

impl Authority {
    /// Makes an authority and writes it into a folder, which is made if it is not there.
    ///
    /// # Errors
    /// When there is one already, or the folder cannot be written to.
    pub fn init(folder: &Path) -> Result<Self> {
        let key = KeyPair::generate_for(&PKCS_ED25519).context("a key cannot be made")?;
        let params = authority_params(&key, Validity::days(AUTHORITY_DAYS)?);
        let certificate = params.self_signed(&key).context("a certificate cannot be made")?.pem();
        let files = [(AUTHORITY_KEY, &key.serialize_pem(), 0o600), (AUTHORITY, &certificate, 0o644)];
        write_new(folder, &files)?;
        let namespace = namespace_of(&key);
        Ok(Self { issuer: Issuer::new(params, key), certificate, namespace })
    }

    /// The authority in a folder.
    ///
    /// # Errors
    /// When there is none.
    pub fn open(folder: &Path) -> Result<Self> {
        let hint = "hint: `loopbox keys init DIR` makes an authority";
        let path = folder.join(AUTHORITY_KEY);
        if !path.exists() {
            bail!("{}: holds no authority: there is no {AUTHORITY_KEY}\n{hint}", folder.display());
        }
        let key = KeyPair::from_pkcs8_der_and_sign_algo(&read_key(&path)?, &PKCS_ED25519)
            .map_err(|error| anyhow!("{}: is no private key of Ed25519: {error}\n{hint}", path.display()))?;
        let path = folder.join(AUTHORITY);
        read_certificate(&path)?;
        let certificate =
            fs::read_to_string(&path).with_context(|| format!("{}: cannot be read", path.display()))?;
        let params = authority_params(&key, Validity::days(AUTHORITY_DAYS)?);
        let namespace = namespace_of(&key);
        Ok(Self { issuer: Issuer::new(params, key), certificate, namespace })
    }

    /// Makes a certificate for a peer and writes it into a folder, which is made if it is not there, with its key and
    /// the authority's certificate. One made again for the same name is the same peer's.
    ///
    /// # Errors
    /// When the peer cannot be called so, there are keys in the folder already, or it cannot be written to.
    pub fn issue(&self, name: &str, validity: Validity, folder: &Path) -> Result<()> {
        if !is_peer_name(name) {
            bail!(
                "{name:?}: no agent can be called so\nhint: letters, digits, '-', '_' and '.', at most {MAX_PEER_NAME} of \
                 them"
            );
        }
        let key = KeyPair::generate_for(&PKCS_ED25519).context("a key cannot be made")?;
        let mut params = CertificateParams::default();
        params.distinguished_name = rcgen::DistinguishedName::new();
        params.distinguished_name.push(DnType::CommonName, name);
        let uri = Peer::uri(Uuid::new_v5(&self.namespace, name.as_bytes()), name);
        let names = [SanType::URI(uri.try_into()?), SanType::DnsName(EVERY_PEER.try_into()?)];
        params.subject_alt_names = names.to_vec();
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages =
            vec![ExtendedKeyUsagePurpose::ClientAuth, ExtendedKeyUsagePurpose::ServerAuth];
        params.use_authority_key_identifier_extension = true;
        (params.not_before, params.not_after) = (validity.from.into(), validity.until.into());
        let certificate = params.signed_by(&key, &self.issuer).context("a certificate cannot be made")?;
        let files = [
            (KEY, &key.serialize_pem(), 0o600),
            (CERTIFICATE, &certificate.pem(), 0o644),
            (AUTHORITY, &self.certificate, 0o644),
        ];
        write_new(folder, &files)
    }
}

/// What an authority's certificate says. Two authorities are never called the same, so that it shows at once which of
/// them a certificate is of.
fn authority_params(key: &KeyPair, validity: Validity) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = rcgen::DistinguishedName::new();
    let name = format!("loopbox fleet {}", namespace_of(key).simple());
    params.distinguished_name.push(DnType::CommonName, name);
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::DigitalSignature];
    (params.not_before, params.not_after) = (validity.from.into(), validity.until.into());
    params
}

fn namespace_of(key: &KeyPair) -> Uuid {
    Uuid::new_v5(&Uuid::NAMESPACE_OID, key.public_key_raw())
}

/// Writes files with their permissions, none of which may be there.
fn write_new(folder: &Path, files: &[(&str, &String, u32)]) -> Result<()> {
    if let Some((there, ..)) = files.iter().find(|(name, ..)| folder.join(name).exists()) {
        bail!(
            "{}: is there already, and keys are never replaced\nhint: give another folder, or remove it yourself",
            folder.join(there).display()
        );
    }
    let write = |name: &str, text: &str, mode: u32| -> std::io::Result<()> {
        let mut file = OpenOptions::new().write(true).create_new(true).mode(mode).open(folder.join(name))?;
        file.write_all(text.as_bytes())?;
        file.sync_all()
    };
    fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    for (name, text, mode) in files {
        write(name, text, *mode)
            .with_context(|| format!("{}: cannot be written", folder.join(name).display()))?;
    }
    Ok(())
}
