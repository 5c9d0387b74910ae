use super::*;
use crate::hash::ObjectHash;
use map::Identity;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::{Duration, SystemTime};

fn keys(authority: &Authority, name: &str, folder: &Path) -> Keys {
    authority.issue(name, Validity::days(30).unwrap(), folder).unwrap();
    Keys::open(folder).unwrap()
}

fn refused<T>(result: anyhow::Result<T>) -> String {
    format!("{:#}", result.err().expect("it is refused"))
}

#[test]
fn a_peer_keeps_its_uuid_when_its_certificate_is_made_anew() {
    let room = tempfile::tempdir().unwrap();
    let at = |name: &str| room.path().join(name);
    let authority = Authority::init(&at("authority")).unwrap();
    let one = keys(&authority, "car-7", &at("one"));
    let again = keys(&Authority::open(&at("authority")).unwrap(), "car-7", &at("again"));
    assert_eq!((one.peer().id, &one.peer().name[..]), (again.peer().id, "car-7"));
    assert_ne!(one.peer(), again.peer(), "the key is another one");
    let now = SystemTime::now();
    assert_eq!((one.check(now), again.check(now)), (Ok(()), Ok(())));
    assert!(one.check(now + Duration::from_secs(31 * 86_400)).unwrap_err().contains("expired"));
    assert!(one.check(now - Duration::from_secs(2 * 86_400)).unwrap_err().contains("not valid yet"));
    let other = Authority::init(&at("other")).unwrap();
    assert_ne!(keys(&other, "car-7", &at("foreign")).peer().id, one.peer().id);
    fs::copy(at("other").join(AUTHORITY), at("one").join(AUTHORITY)).unwrap();
    assert!(Keys::open(&at("one")).unwrap().check(now).unwrap_err().contains("not of the authority"));
}

#[test]
fn private_keys_are_their_owners_alone_and_nothing_is_replaced() {
    let room = tempfile::tempdir().unwrap();
    let at = |name: &str| room.path().join(name);
    let authority = Authority::init(&at("authority")).unwrap();
    keys(&authority, "a", &at("a"));
    keys(&authority, "b", &at("b"));
    for key in [at("authority").join("authority.key"), at("a").join(KEY)] {
        assert_eq!(fs::metadata(&key).unwrap().permissions().mode() & 0o777, 0o600, "{}", key.display());
    }
    let before = fs::read(at("a").join(KEY)).unwrap();
    assert!(refused(authority.issue("a", Validity::days(1).unwrap(), &at("a"))).contains("never replaced"));
    assert!(refused(Authority::init(&at("authority"))).contains("never replaced"));
    assert_eq!(fs::read(at("a").join(KEY)).unwrap(), before);
    for name in ["", "a/b", "ä", "a b", &"x".repeat(49)] {
        assert!(
            refused(authority.issue(name, Validity::days(1).unwrap(), &at("x"))).contains("be called so")
        );
    }
    assert!(Validity::days(0).is_err() && Validity::days(40_000).is_err());
    fs::set_permissions(at("a").join(KEY), fs::Permissions::from_mode(0o640)).unwrap();
    assert!(refused(Keys::open(&at("a"))).contains("chmod 600"));
    fs::copy(at("b").join(KEY), at("a").join(KEY)).unwrap();
    fs::set_permissions(at("a").join(KEY), fs::Permissions::from_mode(0o600)).unwrap();
    assert!(refused(Keys::open(&at("a"))).contains("is not the key of"));
    assert!(refused(Keys::open(&at("nowhere"))).contains("hint"));
    assert!(refused(Authority::open(&at("b"))).contains("holds no authority"));
}

#[test]
fn a_signature_is_of_one_peer_and_one_version() {
    let room = tempfile::tempdir().unwrap();
    let authority = Authority::init(&room.path().join("authority")).unwrap();
    let [a, b] = ["a", "b"].map(|name| keys(&authority, name, &room.path().join(name)));
    let agent = Identity { uuid: Uuid::from_u128(7), epoch: 0 };
    let version =
        MapVersion { agent, begun: 5, revision: 6, newest: 7, size: 8, hash: ObjectHash::of(b"a list") };
    let signature = a.signer().sign(&version);
    assert!(a.peer().has_signed(&version, &signature) && !b.peer().has_signed(&version, &signature));
    let others = [
        MapVersion { agent: agent.later(1), ..version },
        MapVersion { begun: 6, ..version },
        MapVersion { revision: 7, ..version },
        MapVersion { newest: 8, ..version },
        MapVersion { size: 9, ..version },
        MapVersion { hash: ObjectHash::of(b"another"), ..version },
    ];
    assert!(others.iter().all(|other| !a.peer().has_signed(other, &signature)));
    let mut forged = signature;
    forged[5] ^= 1;
    assert!(!a.peer().has_signed(&version, &forged));
}

#[test]
fn what_is_no_certificate_of_a_peer_is_nobodys() {
    let room = tempfile::tempdir().unwrap();
    let authority = Authority::init(room.path()).unwrap();
    let a = keys(&authority, "a", &room.path().join("a"));
    assert_eq!(Peer::of_certificate(&a.certificate).as_ref(), Ok(a.peer()));
    for end in 0..a.certificate.len() {
        assert!(Peer::of_certificate(&a.certificate[..end]).is_err());
    }
    assert!(Peer::of_certificate(&a.authority).unwrap_err().contains("no party"));
}
