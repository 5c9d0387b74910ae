//! Recordings that lie in buckets, copied once.

use super::copies::{cache, copied, copy_hint, joined, kept_at, parted};
use super::{Blobs, BucketBlobs};
use crate::results::digest::hex;
use anyhow::{Context, Result, bail};
use sha2::{Digest, Sha256};
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

/// The URIs of all that lies right under a prefix, an object or a folder each, where a URI ends with `/*`; else the URI.
///
/// # Errors
/// When the bucket cannot be read, or nothing lies there.
pub(super) fn listed(uri: &str) -> Result<Vec<PathBuf>> {
    let Some(folder) = uri.strip_suffix("/*") else { return Ok(vec![uri.into()]) };
    let (bucket, name) = parted(folder);
    listed_among(&BucketBlobs::at(bucket)?, name)
}

fn listed_among(blobs: &dyn Blobs, folder: &str) -> Result<Vec<PathBuf>> {
    let prefix = joined(folder, "");
    let names = blobs.list(&prefix)?;
    let within = names.iter().filter_map(|name| name.strip_prefix(&prefix)?.split('/').next());
    let first: BTreeSet<&str> = within.filter(|first| !is_hidden(first)).collect();
    if first.is_empty() {
        bail!("{}: nothing lies there", blobs.address(&joined(folder, "*")));
    }
    Ok(first.into_iter().map(|name| blobs.address(&joined(folder, name)).into()).collect())
}

/// The recording at a URI, an object or all objects under that name, in the user's cache: `SCHEME/BUCKET/NAME/VERSION/LAST-PART-OF-NAME`.
/// Several processes may copy it at a time.
///
/// # Errors
/// When there is none, or it cannot be copied.
pub(super) fn local(uri: &str, report: &dyn Fn(&str)) -> Result<PathBuf> {
    let (bucket, name) = parted(uri.trim_end_matches('/'));
    recording(&BucketBlobs::at(bucket)?, name, &cache("recordings"), report)
}

fn recording(blobs: &BucketBlobs, name: &str, cache: &Path, report: &dyn Fn(&str)) -> Result<PathBuf> {
    let address = blobs.address(name);
    let called = address.trim_end_matches('/').rsplit('/').next().unwrap_or_default();
    if !name.is_empty()
        && let Some(file) = copied(blobs, name, cache, called, report)?
    {
        return Ok(file);
    }
    let prefix = joined(name, "");
    let mut objects = blobs.versions(&prefix)?;
    objects.retain(|(object, _)| !object[prefix.len()..].split('/').any(is_hidden));
    if objects.is_empty() {
        bail!("{address}: there is no recording\nhint: name an object, or the prefix of a folder's objects");
    }
    let listed: String = objects.iter().map(|(object, version)| format!("{object} {version}\n")).collect();
    let room = kept_at(cache, &address).join(&hex(&Sha256::digest(listed))[..32]);
    let folder = room.join(called);
    if folder.is_dir() {
        return Ok(folder);
    }
    report(&format!("copying {address}, {} objects", objects.len()));
    let hint = || copy_hint(&room, &address);
    fs::create_dir_all(&room).with_context(hint)?;
    let copy = tempfile::TempDir::new_in(&room).with_context(hint)?;
    let whole = copy.path().join(called);
    for (object, _) in &objects {
        let file = whole.join(&object[prefix.len()..]);
        fs::create_dir_all(file.parent().unwrap_or(&whole)).with_context(hint)?;
        blobs.copy(object, &mut File::create(&file).with_context(hint)?)?;
    }
    match fs::rename(&whole, &folder) {
        // Another process was quicker, with the same.
        Err(_) if folder.is_dir() => Ok(folder),
        renamed => renamed.map(|()| folder).with_context(hint),
    }
}

/// Whether a part of a name is no name of a file, or of one that is hidden.
fn is_hidden(part: &str) -> bool {
    part.is_empty() || part.starts_with('.')
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    #[test]
    fn a_recording_is_an_object_or_a_folder_of_them_and_is_copied_once() {
        let (blobs, cache) = (BucketBlobs::in_memory("s3://bucket"), tempfile::tempdir().unwrap());
        let objects = [
            ("walks/a.mcap", "a"),
            ("walks/b/images/0.png", "0"),
            ("walks/b/times.txt", "t"),
            ("walks/b/.lock", "l"),
        ];
        objects.iter().for_each(|(name, bytes)| blobs.put(name, bytes.as_bytes()).unwrap());
        let all = ["s3://bucket/walks/a.mcap", "s3://bucket/walks/b"].map(PathBuf::from);
        assert_eq!(listed_among(&blobs, "walks").unwrap(), all);
        assert!(listed_among(&blobs, "none").unwrap_err().to_string().starts_with("s3://bucket/none/*: "));

        let said = RefCell::new(Vec::new());
        let local = |name: &str| {
            recording(&blobs, name, cache.path(), &|text| said.borrow_mut().push(text.to_owned()))
        };
        let file = local("walks/a.mcap").unwrap();
        assert!(file.ends_with("a.mcap") && fs::read(&file).unwrap() == b"a", "{file:?}");
        let folder = local("walks/b").unwrap();
        assert!(
            folder.ends_with("b") && folder.starts_with(cache.path().join("s3/bucket/walks/b")),
            "{folder:?}"
        );
        assert_eq!(fs::read(folder.join("images/0.png")).unwrap(), b"0");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 2, "what is hidden is not copied");
        assert_eq!(fs::read_dir(folder.parent().unwrap()).unwrap().count(), 1, "nothing is left on its way");
        assert_eq!(
            said.take(),
            ["copying s3://bucket/walks/a.mcap", "copying s3://bucket/walks/b, 2 objects"]
        );

        // Again it is there; what was put anew is another one.
        assert!(local("walks/a.mcap").unwrap() == file && local("walks/b").unwrap() == folder);
        assert!(said.take().is_empty());
        blobs.put("walks/b/images/1.png", b"1").unwrap();
        let grown = local("walks/b").unwrap();
        assert!(grown != folder && fs::read(grown.join("images/1.png")).unwrap() == b"1");
        let refused = local("walks/c").unwrap_err().to_string();
        assert!(refused.starts_with("s3://bucket/walks/c: there is no recording\nhint: "), "{refused}");
    }
}
