//! Maps that lie in buckets, copied once.

use super::{Blobs, BucketBlobs, LocalMap, MAP, MAP_EXTENSION, maps_among};
use anyhow::{Context, Result, bail};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Copies maps into the user's cache: `SCHEME/BUCKET/NAME/VERSION/map.mcap`, so that the path says where a map is from, and an object that
/// was put anew is another file. Several processes may do so at a time.
pub(super) struct Copies<'a> {
    cache: PathBuf,
    report: &'a dyn Fn(&str),
    /// Those that were asked, by their URIs.
    buckets: BTreeMap<String, BucketBlobs>,
}

impl<'a> Copies<'a> {
    pub fn new(report: &'a dyn Fn(&str)) -> Self {
        Self { cache: cache("maps"), report, buckets: BTreeMap::new() }
    }

    /// The map at a URI, or all under a prefix.
    ///
    /// # Errors
    /// When there is none, or it cannot be copied.
    pub fn of(&mut self, uri: &str) -> Result<Vec<LocalMap>> {
        let (bucket, name) = parted(uri.trim_end_matches('/'));
        if !self.buckets.contains_key(bucket) {
            self.buckets.insert(bucket.to_owned(), BucketBlobs::at(bucket)?);
        }
        let (blobs, cache, report) = (&self.buckets[bucket], &self.cache, self.report);
        let Some(prefix) = name.strip_suffix('*').filter(|prefix| prefix.is_empty() || prefix.ends_with('/'))
        else {
            let object = if name.ends_with(MAP_EXTENSION) { name.to_owned() } else { joined(name, MAP) };
            let Some(local) = copied(blobs, &object, cache, MAP, report)? else {
                bail!(
                    "{}: there is no map\nhint: name a map.mcap, the folder that holds one, or as {bucket}/FOLDER/* all that a folder has",
                    blobs.address(&object)
                );
            };
            return Ok(vec![LocalMap { given: uri.into(), local }]);
        };
        let mut maps = Vec::new();
        for object in maps_among(&blobs.list(prefix)?, prefix) {
            if let Some(local) = copied(blobs, &object, cache, MAP, report)? {
                maps.push(LocalMap { given: blobs.address(&object).into(), local });
            }
        }
        if maps.is_empty() {
            bail!(
                "{uri}: there is no map\nhint: a map is a map.mcap in a folder there, or a file of another name with .mcap behind"
            );
        }
        Ok(maps)
    }
}

/// Bucket and name of a URI.
pub(super) fn parted(uri: &str) -> (&str, &str) {
    let begin = uri.find("://").map_or(0, |at| at + 3);
    match uri[begin..].find('/') {
        Some(at) => (&uri[..begin + at], &uri[begin + at + 1..]),
        None => (uri, ""),
    }
}

pub(super) fn joined(folder: &str, name: &str) -> String {
    if folder.is_empty() { name.to_owned() } else { format!("{folder}/{name}") }
}

/// The folder of the versions of what has an address.
pub(super) fn kept_at(cache: &Path, address: &str) -> PathBuf {
    // Names in buckets are of any kind, and two dots among them are a folder's.
    let parts = address
        .split('/')
        .map(|part| part.trim_end_matches(':'))
        .filter(|part| !part.is_empty() && !part.starts_with('.'));
    cache.join(parts.collect::<PathBuf>())
}

/// Says that no copy can be made, and what to do.
pub(super) fn copy_hint(folder: &Path, address: &str) -> String {
    let folder = folder.display();
    format!(
        "{folder}: {address} cannot be copied to there\nhint: XDG_CACHE_HOME names a folder that has room for it"
    )
}

/// The file of an object, which is copied if it is not there and has the name that is given; nothing where there is no such object.
pub(super) fn copied(
    blobs: &BucketBlobs,
    object: &str,
    cache: &Path,
    called: &str,
    report: &dyn Fn(&str),
) -> Result<Option<PathBuf>> {
    let Some(version) = blobs.version(object)? else { return Ok(None) };
    let address = blobs.address(object);
    let folder = kept_at(cache, &address).join(version);
    let file = folder.join(called);
    if file.is_file() {
        return Ok(Some(file));
    }
    report(&format!("copying {address}"));
    let hint = || copy_hint(&folder, &address);
    fs::create_dir_all(&folder).with_context(hint)?;
    let mut copy = tempfile::NamedTempFile::new_in(&folder).with_context(hint)?;
    if !blobs.copy(object, copy.as_file_mut())? {
        return Ok(None);
    }
    copy.persist(&file).with_context(hint)?;
    Ok(Some(file))
}

/// Where copies of maps or recordings are kept.
pub(super) fn cache(what: &str) -> PathBuf {
    let named = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let cache = named("XDG_CACHE_HOME").or_else(|| Some(named("HOME")?.join(".cache")));
    cache.unwrap_or_else(std::env::temp_dir).join("loopbox").join(what)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_uri_is_a_bucket_and_a_name() {
        assert_eq!(parted("s3://bucket/a/map.mcap"), ("s3://bucket", "a/map.mcap"));
        assert_eq!(parted("gs://bucket"), ("gs://bucket", ""));
    }
}
