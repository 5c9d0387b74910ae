//! Who may take part: the fleet's authority, a certificate for each peer, and signatures under what is told.
//!
//! A peer is a machine or whoever else was given a certificate. It is called by a name and by a UUID made of the name and
//! the authority, so that a certificate made anew for the same name is the same peer's. What a peer tells is under that
//! UUID: no other peer can tell it, or more of it.

mod files;
mod making;
#[cfg(test)]
mod tests;

pub use files::{AUTHORITY, CERTIFICATE, KEY, Keys};
pub use making::{Authority, DAYS, Validity};

use crate::bytes::Writer;
use crate::wire::{MapVersion, Signature};
use map::Uuid;
use ring::signature::{ED25519, Ed25519KeyPair, UnparsedPublicKey};
use rustls::pki_types::CertificateDer;
use webpki::EndEntityCert;

/// Longest name of a peer, bytes.
pub const MAX_PEER_NAME: usize = 48;
/// The name that all certificates are valid for: peers are told apart by their own, not by where they are.
pub(crate) const EVERY_PEER: &str = "fleet.loopbox";
/// What a peer's own name begins with in its certificate.
const SCHEME: &str = "loopbox-fleet:";
/// What precedes an Ed25519 key in a certificate (RFC 8410, §4).
const ED25519_KEY: [u8; 12] = [0x30, 0x2a, 0x30, 5, 6, 3, 0x2b, 0x65, 0x70, 3, 0x21, 0];
/// What is signed begins with, so that no signature under it stands under anything else.
const SIGNED: &[u8] = b"loopbox fleet state 1\0";

/// Whose a certificate is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Peer {
    /// The peer, for programs: what it tells is under this.
    pub id: Uuid,
    /// The peer, for people.
    pub name: String,
    /// By which its signatures are checked.
    key: [u8; 32],
}

impl Peer {
    /// Whose a certificate is, in DER. Whether it is to be believed is not looked at.
    ///
    /// # Errors
    /// When it is no certificate, or none of a fleet.
    pub fn of_certificate(der: &[u8]) -> Result<Self, String> {
        let der = CertificateDer::from(der);
        let certificate = EndEntityCert::try_from(&der).map_err(|error| format!("it is damaged: {error}"))?;
        let mut names = certificate.valid_uri_names().filter_map(|name| name.strip_prefix(SCHEME));
        let name = names.next().ok_or("it names no party of a fleet")?;
        let parted = name.split_once('/').filter(|(_, name)| is_peer_name(name));
        let (id, name) = parted
            .and_then(|(id, name)| Some((Uuid::try_parse(id).ok()?, name)))
            .ok_or_else(|| format!("it names a party {name:?}, which none is called"))?;
        let key = certificate.subject_public_key_info();
        let key = key.strip_prefix(&ED25519_KEY).and_then(|key| key.try_into().ok());
        Ok(Self { id, name: name.to_owned(), key: key.ok_or("its key is none of Ed25519")? })
    }

    /// How it is named in its certificate.
    fn uri(id: Uuid, name: &str) -> String {
        format!("{SCHEME}{id}/{name}")
    }

    /// Whether the peer told a version of a map.
    pub fn has_signed(&self, version: &MapVersion, signature: &Signature) -> bool {
        UnparsedPublicKey::new(&ED25519, self.key).verify(&signed(self.id, version), signature).is_ok()
    }
}

/// Whether a peer can be called so: letters and digits of ASCII, `-`, `_` and `.`, at most [`MAX_PEER_NAME`].
pub fn is_peer_name(name: &str) -> bool {
    let is_allowed = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    (1..=MAX_PEER_NAME).contains(&name.len()) && name.chars().all(is_allowed)
}

/// Signs what a peer tells.
pub struct Signer {
    peer: Peer,
    key: Ed25519KeyPair,
}

impl Signer {
    /// Whose.
    pub fn peer(&self) -> &Peer {
        &self.peer
    }

    /// The signature under a version of a map: with it under the manifest's hash, and so under all of the map.
    pub fn sign(&self, version: &MapVersion) -> Signature {
        let mut signature = [0; 64];
        signature.copy_from_slice(self.key.sign(&signed(self.peer.id, version)).as_ref());
        signature
    }
}

impl std::fmt::Debug for Signer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Signer({})", self.peer.name)
    }
}

/// What is signed of a version of a map that `peer` tells.
fn signed(peer: Uuid, version: &MapVersion) -> Vec<u8> {
    let mut out = Writer(SIGNED.to_vec());
    out.bytes(peer.as_bytes());
    version.write(&mut out);
    out.0
}
