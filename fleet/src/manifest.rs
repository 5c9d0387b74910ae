//! What an agent's map consists of: objects, named and listed.
//!
//! An object is immutable: its name is agent, epoch, number, kind and revision, and its content has a hash. The list of a
//! map's objects is cut into pages, which are objects themselves, and the [`Manifest`] lists the pages: so of a map that
//! grew only the pages are new on which something is.

use crate::bytes::{Malformed, Reader, Writer};
use crate::hash::ObjectHash;
use map::{Identity, SensorKind};
use std::sync::Arc;

/// Largest object, bytes: an image of 16 megapixels that packs badly, or its depths.
pub const MAX_OBJECT: u32 = 64 << 20;
/// Largest manifest, bytes.
pub const MAX_LIST: u32 = 1 << 20;
/// Entries on a page: at 45 bytes each 6 kB, which is what a keyframe's change costs.
pub const ENTRIES: usize = 128;
/// Largest page, bytes.
const MAX_PAGE: u32 = 6 + 45 * ENTRIES as u32;
/// Pages of a manifest: 26,000 keyframes and more.
const MAX_PAGES: usize = (MAX_LIST / 64) as usize;
/// What manifests and pages begin with, and the version.
const MANIFEST: u32 = u32::from_le_bytes(*b"lbm1");
const PAGE: u32 = u32::from_le_bytes(*b"lbp1");

/// What an object holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Kind {
    /// Who the agent is, [`map::parts::agent_to_bytes`]; number 0.
    Agent = 0,
    /// Poses of keyframes, [`map::parts::graph_to_bytes`]; numbered from 0 in order of the keyframes.
    Poses = 1,
    /// A keyframe's features, as the crate `features` encodes them; the number is the keyframe's.
    Features = 2,
    /// A keyframe's time, depth and points, [`map::parts::depth_to_bytes`]; of a LiDAR's the time alone.
    Depth = 3,
    /// A keyframe's image, [`map::parts::image_to_bytes`].
    Image = 4,
    /// Edges, numbered from 0 in the order of the map.
    Edges = 5,
    /// Frames, likewise.
    Frames = 6,
    /// A keyframe in a kilobyte, [`crate::lossy_codec::digest`].
    Digest = 7,
    /// A keyframe's image with a little less in it, [`crate::lossy_codec::image`].
    LossyImage = 8,
    /// A keyframe's depth likewise, [`crate::lossy_codec::depth`].
    LossyDepth = 9,
    /// The points of a LiDAR's keyframe, [`map::parts::scan_to_bytes`].
    Scan = 10,
    /// The colours of a keyframe's image, [`map::parts::color_to_bytes`].
    Color = 11,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 12] = [
        Self::Agent,
        Self::Poses,
        Self::Digest,
        Self::Features,
        Self::LossyDepth,
        Self::LossyImage,
        Self::Depth,
        Self::Image,
        Self::Scan,
        Self::Color,
        Self::Edges,
        Self::Frames,
    ];

    /// Whether it stands in for another one, and only until that is there: the whole map needs none of it.
    pub fn is_preview(self) -> bool {
        self.stands_in_for().is_some()
    }

    /// What it stands in for.
    pub fn stands_in_for(self) -> Option<Self> {
        match self {
            Self::LossyImage => Some(Self::Image),
            Self::LossyDepth => Some(Self::Depth),
            _ => None,
        }
    }

    /// Whether its number is a keyframe's.
    pub fn is_of_keyframe(self) -> bool {
        !matches!(self, Self::Agent | Self::Poses | Self::Edges | Self::Frames)
    }

    fn from_number(number: u8) -> Result<Self, Malformed> {
        let found = Self::ALL.into_iter().find(|kind| *kind as u8 == number);
        found.ok_or(Malformed::Kind(number))
    }
}

/// The kind of an agent's sensor by the objects of its map, once a keyframe is among them.
pub fn sensor_of(entries: &[Entry]) -> Option<SensorKind> {
    entries.iter().find_map(|entry| match entry.kind {
        Kind::Image => Some(SensorKind::Camera),
        Kind::Scan => Some(SensorKind::Lidar),
        _ => None,
    })
}

/// An object of a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Entry {
    /// What it holds.
    pub kind: Kind,
    /// Of which keyframe, or which of its kind.
    pub number: u32,
    /// How often it was replaced.
    pub revision: u32,
    /// Its size, bytes.
    pub size: u32,
    /// Its content.
    pub hash: ObjectHash,
}

/// What a page lists.
pub type Page = Arc<[Entry]>;

/// A page of a list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PageRef {
    /// Its size, bytes.
    pub size: u32,
    /// Its content.
    pub hash: ObjectHash,
}

/// A version of an agent's map. Of two the later is that of the later `begun`, then of the higher `revision`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Manifest {
    /// Whose map.
    pub agent: Identity,
    /// When the agent began to tell this map, milliseconds since 1970: a run that is repeated begins anew.
    pub begun: u64,
    /// How often it changed since.
    pub revision: u64,
    /// Whether the run has ended: the map will not change any more.
    pub finished: bool,
    /// Its objects.
    pub pages: Vec<PageRef>,
}

impl Manifest {
    /// As bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Writer::default();
        out.u32(MANIFEST);
        out.identity(self.agent);
        out.u64(self.begun);
        out.u64(self.revision);
        out.u8(self.finished.into());
        out.u32(self.pages.len() as u32);
        for page in &self.pages {
            out.u32(page.size);
            out.bytes(&page.hash.0);
        }
        out.0
    }

    /// The inverse of [`to_bytes`](Self::to_bytes).
    ///
    /// # Errors
    /// When the bytes are no manifest.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Malformed> {
        let mut from = Reader::new(bytes);
        expect(&mut from, MANIFEST)?;
        let (agent, begun, revision) = (from.identity()?, from.u64()?, from.u64()?);
        let finished = flag(from.u8()?)?;
        let count = from.u32()?;
        if count as usize > MAX_PAGES {
            return Err(Malformed::Range("the number of pages", count.into()));
        }
        let page = |_| {
            let size = within("the size of a page", from.u32()?, MAX_PAGE)?;
            Ok(PageRef { size, hash: ObjectHash(from.array()?) })
        };
        let pages = (0..count).map(page).collect::<Result<_, Malformed>>()?;
        from.end()?;
        Ok(Self { agent, begun, revision, finished, pages })
    }
}

/// A page as bytes.
pub fn page_to_bytes(entries: &[Entry]) -> Vec<u8> {
    let mut out = Writer::default();
    out.u32(PAGE);
    out.u16(entries.len() as u16);
    for entry in entries {
        out.u8(entry.kind as u8);
        out.u32(entry.number);
        out.u32(entry.revision);
        out.u32(entry.size);
        out.bytes(&entry.hash.0);
    }
    out.0
}

/// The inverse of [`page_to_bytes`].
///
/// # Errors
/// When the bytes are no page.
pub fn page_from_bytes(bytes: &[u8]) -> Result<Page, Malformed> {
    let mut from = Reader::new(bytes);
    expect(&mut from, PAGE)?;
    let count = from.u16()?;
    if usize::from(count) > ENTRIES {
        return Err(Malformed::Range("the number of entries", count.into()));
    }
    let entry = |_| {
        let kind = Kind::from_number(from.u8()?)?;
        let (number, revision) = (from.u32()?, from.u32()?);
        let size = within("the size of an object", from.u32()?, MAX_OBJECT)?;
        Ok(Entry { kind, number, revision, size, hash: ObjectHash(from.array()?) })
    };
    let entries = (0..count).map(entry).collect::<Result<_, Malformed>>()?;
    from.end()?;
    Ok(entries)
}

fn expect(from: &mut Reader, magic: u32) -> Result<(), Malformed> {
    match from.u32()? {
        found if found == magic => Ok(()),
        found => Err(Malformed::Range("the beginning of a list", found.into())),
    }
}

/// A truth value.
pub(crate) fn flag(number: u8) -> Result<bool, Malformed> {
    match number {
        0 | 1 => Ok(number == 1),
        _ => Err(Malformed::Range("a truth value", number.into())),
    }
}

/// A number that is not larger than it may be.
pub(crate) fn within(what: &'static str, number: u32, largest: u32) -> Result<u32, Malformed> {
    if number > largest { Err(Malformed::Range(what, number.into())) } else { Ok(number) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use map::Uuid;

    fn entries(count: u32) -> Vec<Entry> {
        let entry = |i: u32| Entry {
            kind: Kind::ALL[i as usize % Kind::ALL.len()],
            number: i,
            revision: i / 3,
            size: 1000 + i,
            hash: ObjectHash::of(&i.to_le_bytes()),
        };
        (0..count).map(entry).collect()
    }

    fn manifest(pages: u32) -> Manifest {
        let page = |i: u32| PageRef { size: i, hash: ObjectHash::of(&i.to_le_bytes()) };
        let agent = Identity { uuid: Uuid::from_u128(7), epoch: 3 };
        Manifest { agent, begun: 1 << 40, revision: 5, finished: true, pages: (0..pages).map(page).collect() }
    }

    #[test]
    fn lists_come_back() {
        let (page, list) = (entries(ENTRIES as u32), manifest(9));
        assert_eq!(page_from_bytes(&page_to_bytes(&page)), Ok(page.into()));
        assert_eq!(Manifest::from_bytes(&list.to_bytes()), Ok(list));
    }

    #[test]
    fn lists_that_are_cut_or_too_long_are_refused() {
        let (page, list) = (page_to_bytes(&entries(3)), manifest(3).to_bytes());
        for end in 0..page.len() {
            assert!(page_from_bytes(&page[..end]).is_err());
        }
        for end in 0..list.len() {
            assert!(Manifest::from_bytes(&list[..end]).is_err());
        }
        assert_eq!(page_from_bytes(&[page.clone(), vec![0]].concat()), Err(Malformed::Long(1)));
        let mut huge = page;
        huge[4..6].fill(0xff);
        assert_eq!(page_from_bytes(&huge), Err(Malformed::Range("the number of entries", 0xffff)));
        let mut huge = list;
        huge[41..45].fill(0xff);
        assert!(matches!(Manifest::from_bytes(&huge), Err(Malformed::Range("the number of pages", _))));
    }

    /// What a version that knows one kind of object less makes of it.
    #[test]
    fn a_kind_that_is_not_known_is_refused_by_its_number() {
        let mut page = page_to_bytes(&entries(3));
        page[6] = 99;
        let error = page_from_bytes(&page).unwrap_err();
        assert_eq!(error, Malformed::Kind(99));
        assert!(error.to_string().contains("kind 99") && error.to_string().contains("newer version"));
    }

    #[test]
    fn a_full_manifest_fits() {
        assert!(manifest(MAX_PAGES as u32).to_bytes().len() < MAX_LIST as usize);
    }
}
