//! The vocabulary's file: little-endian, checksummed, compressed by zlib (RFC 1950). Files that are not compressed are read as well.
//!
//! | bytes | what |
//! |---|---|
//! | 8 | `LBVOCAB` and a zero |
//! | 4 | version |
//! | 4 | CRC-32 of all that follows |
//! | 4, 4, 4 | nodes of the tree, words, training images |
//! | nodes | number of children of each node, breadth first |
//! | 128 each | centre of each node |
//! | 12 each | of each word: training images that show it; its parent in the Chow–Liu tree, 0xffffffff for none; training images that show both |

use super::chow_liu::Tie;
use super::tree::Tree;
use super::{Vocabulary, VocabularyError};
use miniz_oxide::deflate::compress_to_vec_zlib;
use miniz_oxide::inflate::{TINFLStatus, decompress_to_vec_zlib_with_limit};
use std::borrow::Cow;

/// The version written; others are refused.
const VERSION: u32 = 1;
const MAGIC: &[u8; 8] = b"LBVOCAB\0";
const HEADER: usize = 16;
const NO_PARENT: u32 = u32::MAX;
/// Most bytes of a file, uncompressed: two million words.
const MAX_BYTES: usize = 1 << 28;
/// Level of compression: the smallest file.
const LEVEL: u8 = 10;

impl Vocabulary {
    /// The vocabulary as the bytes of a file.
    pub fn to_bytes(&self) -> Vec<u8> {
        compress_to_vec_zlib(&self.to_plain_bytes(), LEVEL)
    }

    /// The file's bytes before they are compressed.
    pub(super) fn to_plain_bytes(&self) -> Vec<u8> {
        let mut body = Vec::new();
        for count in [self.tree.centres.len(), self.tree.words(), self.images as usize] {
            body.extend((count as u32).to_le_bytes());
        }
        body.extend(&self.tree.child_counts);
        body.extend(self.tree.centres.as_flattened());
        for (count, tie) in self.counts.iter().zip(&self.ties) {
            for value in [*count, tie.parent.unwrap_or(NO_PARENT), tie.together] {
                body.extend(value.to_le_bytes());
            }
        }
        let mut bytes = MAGIC.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(crc32fast::hash(&body).to_le_bytes());
        bytes.extend(body);
        bytes
    }

    /// Reads what [`Vocabulary::to_bytes`] wrote.
    ///
    /// # Errors
    /// When the bytes are not a vocabulary, are of another version, were cut short or changed.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, VocabularyError> {
        let bytes = inflated(bytes)?;
        let mut header = Reader(&bytes[MAGIC.len()..]);
        let (version, checksum) = (header.number()?, header.number()?);
        if version != VERSION {
            return Err(VocabularyError::OtherVersion { found: version, expected: VERSION });
        }
        let mut body = Reader(&bytes[HEADER..]);
        let (nodes, words, images) = (body.number()? as usize, body.number()? as usize, body.number()?);
        let expected = nodes.saturating_mul(129).saturating_add(words.saturating_mul(12));
        if body.0.len() < expected {
            let missing = expected - body.0.len();
            return Err(VocabularyError::Truncated { missing });
        }
        if crc32fast::hash(&bytes[HEADER..]) != checksum || body.0.len() != expected {
            return Err(VocabularyError::Damaged);
        }
        let child_counts = body.take(nodes)?.to_vec();
        let centres = body.take(128 * nodes)?.as_chunks().0.to_vec();
        let tree = Tree::new(centres, child_counts).filter(|tree| tree.words() == words);
        let tree = tree.ok_or(VocabularyError::Damaged)?;
        let (mut counts, mut ties) = (Vec::with_capacity(words), Vec::with_capacity(words));
        for _ in 0..words {
            let (count, parent, together) = (body.number()?, body.number()?, body.number()?);
            counts.push(count);
            ties.push(Tie { parent: (parent != NO_PARENT).then_some(parent), together });
        }
        let possible = |(count, tie): (&u32, &Tie)| {
            let parent_count = tie.parent.map(|parent| counts.get(parent as usize).copied());
            *count <= images && parent_count.is_none_or(|p| p.is_some_and(|p| tie.together <= p.min(*count)))
        };
        if !counts.iter().zip(&ties).all(possible) {
            return Err(VocabularyError::Damaged);
        }
        Ok(Self::assembled(tree, images, counts, ties))
    }
}

/// The bytes of a file uncompressed: of one that was cut short those that are there.
fn inflated(bytes: &[u8]) -> Result<Cow<'_, [u8]>, VocabularyError> {
    if bytes.starts_with(MAGIC) {
        return Ok(Cow::Borrowed(bytes));
    }
    let (inflated, is_damaged) = match decompress_to_vec_zlib_with_limit(bytes, MAX_BYTES) {
        Ok(inflated) => (inflated, false),
        Err(error) => (error.output, error.status != TINFLStatus::FailedCannotMakeProgress),
    };
    if !inflated.starts_with(MAGIC) {
        return Err(VocabularyError::NotAVocabulary);
    }
    if is_damaged { Err(VocabularyError::Damaged) } else { Ok(Cow::Owned(inflated)) }
}

/// Takes values off the front.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], VocabularyError> {
        let missing = count.saturating_sub(self.0.len());
        let (taken, rest) = self.0.split_at_checked(count).ok_or(VocabularyError::Truncated { missing })?;
        self.0 = rest;
        Ok(taken)
    }

    fn number(&mut self) -> Result<u32, VocabularyError> {
        let bytes = self.take(4)?;
        Ok(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }
}
