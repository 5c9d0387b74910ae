//! Objects in a bucket, by the crate `object_store`: S3 and what speaks like it, Google Cloud Storage, Azure.
//!
//! Requests are asynchronous in here and nowhere else: the thread that asks waits, in a runtime that has no threads of its own.

use super::Blobs;
use anyhow::{Result, anyhow};
use futures_util::TryStreamExt;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::azure::{AzureConfigKey, MicrosoftAzureBuilder};
use object_store::gcp::{GoogleCloudStorageBuilder, GoogleConfigKey};
use object_store::path::Path as Key;
use object_store::{ClientConfigKey, Error, ObjectMeta, ObjectStore, ObjectStoreExt, PutMode, RetryConfig};
use std::fmt::Display;
use std::io::Write;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};

/// How long a request is tried again where the server cannot be reached or says that it is busy.
const PATIENCE: Duration = Duration::from_secs(30);
/// How long one request may last: a map of a gigabyte comes at 10 Mbit/s within a quarter of an hour.
const LONGEST_REQUEST: &str = "1800 seconds";

/// Objects in a bucket, under a prefix of their names; who may read and write says the environment.
#[derive(Debug)]
pub struct BucketBlobs {
    store: Box<dyn ObjectStore>,
    /// The prefix.
    root: Key,
    /// Bucket and prefix, without a `/` behind.
    uri: String,
    runtime: Runtime,
}

impl BucketBlobs {
    /// Those under `uri`: `s3://BUCKET/PREFIX`, `gs://BUCKET/PREFIX` or `az://CONTAINER/PREFIX`. Nothing is asked of the server yet.
    ///
    /// # Errors
    /// When that is no such URI, or the environment says nothing that could be used.
    pub fn at(uri: &str) -> Result<Self> {
        let uri = uri.trim_end_matches('/');
        let store = opened(uri).map_err(|error| named(uri, "cannot be opened", error))?;
        let prefix = uri.splitn(4, '/').nth(3).unwrap_or_default();
        let root = Key::parse(prefix).map_err(|error| named(uri, "is no name of objects", error))?;
        Self::on(store, root, uri)
    }

    fn on(store: Box<dyn ObjectStore>, root: Key, uri: &str) -> Result<Self> {
        let runtime = Builder::new_current_thread().enable_all().build()?;
        Ok(Self { store, root, uri: uri.to_owned(), runtime })
    }

    /// A bucket that is none, in memory.
    #[cfg(test)]
    pub(super) fn in_memory(uri: &str) -> Self {
        Self::on(Box::new(object_store::memory::InMemory::new()), Key::default(), uri).unwrap()
    }

    fn key(&self, name: &str) -> Result<Key> {
        let whole = format!("{}/{name}", self.root);
        Key::parse(whole.trim_end_matches('/'))
            .map_err(|error| named(&self.address(name), "is no name of an object", error))
    }

    /// What is known of an object but its content; nothing where there is none of that name.
    fn about(&self, name: &str) -> Result<Option<ObjectMeta>> {
        let key = self.key(name)?;
        let about = self.runtime.block_on(self.store.head(&key));
        there(about).map_err(|error| named(&self.address(name), "cannot be read", error))
    }

    /// What tells an object from others that had its name before, for the name of a file: its size and its ETag, or where there is
    /// none when it was changed. Nothing where there is no object of that name.
    ///
    /// # Errors
    /// When the server cannot be reached or refuses.
    pub fn version(&self, name: &str) -> Result<Option<String>> {
        Ok(self.about(name)?.as_ref().map(version))
    }

    /// The names that begin so, ascending, with what tells each object from others that had its name before.
    ///
    /// # Errors
    /// When the server cannot be reached or refuses.
    pub fn versions(&self, prefix: &str) -> Result<Vec<(String, String)>> {
        // Servers list by whole words of names.
        let folder = self.key(prefix.rsplit_once('/').map_or("", |(folder, _)| folder))?;
        let all = self.store.list(Some(&folder)).try_collect::<Vec<ObjectMeta>>();
        let all = self.runtime.block_on(all).map_err(|error| named(&self.uri, "cannot be listed", error))?;
        let name = |about: &ObjectMeta| {
            let within = about.location.as_ref().strip_prefix(self.root.as_ref())?.trim_start_matches('/');
            within.starts_with(prefix).then(|| (within.to_owned(), version(about)))
        };
        let mut names: Vec<(String, String)> = all.iter().filter_map(name).collect();
        names.sort();
        Ok(names)
    }

    /// Copies an object; whether there is one of that name.
    ///
    /// # Errors
    /// When the server cannot be reached or refuses, or `into` takes no more.
    pub fn copy(&self, name: &str, into: &mut dyn Write) -> Result<bool> {
        let key = self.key(name)?;
        let copied = self.runtime.block_on(async {
            let Some(object) = there(self.store.get(&key).await)? else { return Ok(false) };
            let mut pieces = object.into_stream();
            while let Some(piece) = pieces.try_next().await? {
                into.write_all(&piece)?;
            }
            Ok::<bool, anyhow::Error>(true)
        });
        copied.map_err(|error| named(&self.address(name), "cannot be copied", format!("{error:#}")))
    }
}

impl Blobs for BucketBlobs {
    fn get(&self, name: &str) -> Result<Option<Vec<u8>>> {
        let mut bytes = Vec::new();
        Ok(self.copy(name, &mut bytes)?.then_some(bytes))
    }

    fn has(&self, name: &str) -> Result<bool> {
        Ok(self.about(name)?.is_some())
    }

    fn put(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let key = self.key(name)?;
        let put = self.store.put_opts(&key, bytes.to_vec().into(), PutMode::Create.into());
        match self.runtime.block_on(put) {
            // Another process put it meanwhile, and the same; or this one, whose answer was lost.
            Ok(_) | Err(Error::AlreadyExists { .. }) => Ok(()),
            Err(error) => Err(named(&self.address(name), "cannot be written", error)),
        }
    }

    fn list(&self, prefix: &str) -> Result<Vec<String>> {
        Ok(self.versions(prefix)?.into_iter().map(|(name, _)| name).collect())
    }

    fn address(&self, name: &str) -> String {
        format!("{}/{name}", self.uri)
    }
}

/// What tells an object from others that had its name before.
fn version(about: &ObjectMeta) -> String {
    let tag = about.e_tag.clone().unwrap_or_else(|| about.last_modified.to_rfc3339());
    let tag: String = tag.chars().filter(char::is_ascii_alphanumeric).collect();
    format!("{tag}-{}", about.size)
}

/// What was asked for; nothing where it is not there.
fn there<T>(found: object_store::Result<T>) -> object_store::Result<Option<T>> {
    match found {
        Ok(found) => Ok(Some(found)),
        Err(Error::NotFound { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

/// The store of a bucket, with what the environment says of it.
fn opened(uri: &str) -> object_store::Result<Box<dyn ObjectStore>> {
    // TLS by ring, as the fleet has it. Where the process has another already, that is used.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let retry = RetryConfig { retry_timeout: PATIENCE, ..RetryConfig::default() };
    let longest = ClientConfigKey::Timeout;
    Ok(match uri.split_once("://").map(|(scheme, _)| scheme) {
        Some("gs") => {
            let builder = GoogleCloudStorageBuilder::from_env().with_url(uri).with_retry(retry);
            Box::new(builder.with_config(GoogleConfigKey::Client(longest), LONGEST_REQUEST).build()?)
        }
        Some("az") => {
            let builder = MicrosoftAzureBuilder::from_env().with_url(uri).with_retry(retry);
            Box::new(builder.with_config(AzureConfigKey::Client(longest), LONGEST_REQUEST).build()?)
        }
        _ => {
            let builder = AmazonS3Builder::from_env().with_url(uri).with_retry(retry);
            Box::new(builder.with_config(AmazonS3ConfigKey::Client(longest), LONGEST_REQUEST).build()?)
        }
    })
}

/// What went wrong where, and what can be done.
fn named(address: &str, what: &str, error: impl Display) -> anyhow::Error {
    let hint = match address.split_once("://").map(|(scheme, _)| scheme) {
        Some("gs") => {
            "does the bucket exist? GOOGLE_SERVICE_ACCOUNT names the file of an account that may read and write it"
        }
        Some("az") => {
            "does the container exist? AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY say who may read and write it"
        }
        _ => {
            "does the bucket exist? AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and AWS_REGION say who may read and write it; \
             of a server that is not Amazon's AWS_ENDPOINT_URL says where it is, with AWS_ALLOW_HTTP=true where it has no TLS"
        }
    };
    anyhow!("{address}: {what}: {error}\nhint: {hint}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blobs::tests::keeps_what_is_put_first;
    use object_store::memory::InMemory;

    #[test]
    fn a_bucket_keeps_what_is_put_first_with_and_without_a_prefix() {
        for (prefix, uri) in [("", "s3://bucket"), ("a/b", "s3://bucket/a/b")] {
            let bucket = BucketBlobs::on(Box::new(InMemory::new()), Key::from(prefix), uri).unwrap();
            keeps_what_is_put_first(&bucket);
            assert_eq!(bucket.address("b/one.x"), format!("{uri}/b/one.x"));
            let [one, two] = ["b/one.x", "b/two.x"].map(|name| bucket.version(name).unwrap().unwrap());
            assert!(one != two && bucket.version("none").unwrap().is_none());
            assert!(one.chars().all(|c| c.is_ascii_alphanumeric() || c == '-'), "{one}");
        }
    }

    #[test]
    fn what_is_no_place_of_objects_is_named_with_what_to_do() {
        let refused = BucketBlobs::at("az://box/a").unwrap_err().to_string();
        let words = ["az://box/a: cannot be opened", "AZURE_STORAGE_ACCOUNT_NAME"];
        assert!(words.iter().all(|word| refused.contains(word)), "{refused}");
    }
}
