//! What two neighbours say to each other. Every message may be lost, come twice or late, and come after a later one.
//!
//! Pushed is only what may be lost, at most 200 bytes each: who one is, what one has, and how much of the other's one has
//! on its disk. All else is asked for in parts of objects.

use crate::bytes::{Malformed, Reader, Writer};
use crate::hash::ObjectHash;
use crate::manifest::{MAX_LIST, MAX_OBJECT, flag, within};
use map::{Identity, Uuid};

/// The versions of the protocol that this program speaks, the oldest and the newest. Who greets says the oldest, in
/// [`Message::Hello`], so that whoever speaks that one understands it, and both in [`Message::Speaks`]. Neighbours that have one
/// in common speak the newest of these; the others are refused.
pub const VERSIONS: [u16; 2] = [3, 3];
/// Largest message, bytes: the largest part of an object and what stands before it.
pub const MAX_MESSAGE: usize = MAX_PART + 64;
/// Largest part of an object that is asked for at once, bytes.
pub const MAX_PART: usize = 32 << 10;
/// Longest name of a neighbour, bytes.
pub const MAX_NAME: usize = 64;
/// Longest reason, bytes.
pub const MAX_REASON: usize = 400;

/// No agent.
const NOBODY: Identity = Identity { uuid: Uuid::nil(), epoch: 0 };

/// What a neighbour is there for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Tells its own map, and merges the maps of the agents that it meets.
    Agent,
    /// Collects the maps of all.
    Station,
}

/// A version of an agent's map that can be asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapVersion {
    /// Whose map.
    pub agent: Identity,
    /// When the agent began to tell it, see [`Manifest::begun`](crate::manifest::Manifest::begun).
    pub begun: u64,
    /// How often it changed since.
    pub revision: u64,
    /// The number of its newest keyframe.
    pub newest: u32,
    /// Its manifest's size, bytes.
    pub size: u32,
    /// Its manifest.
    pub hash: ObjectHash,
}

impl MapVersion {
    /// What orders versions of one map: a later one is larger.
    pub fn order(&self) -> (u64, u64) {
        (self.begun, self.revision)
    }

    /// As bytes, that are said and signed.
    pub(crate) fn write(&self, out: &mut Writer) {
        out.identity(self.agent);
        out.u64(self.begun);
        out.u64(self.revision);
        out.u32(self.newest);
        out.u32(self.size);
        out.bytes(&self.hash.0);
    }
}

/// A signature under a version of a map (Ed25519, RFC 8032).
pub type Signature = [u8; 64];

/// What was found out about where agents are, as an object to be asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ResultsRef {
    /// Which version; later ones are larger.
    pub revision: u64,
    /// Its size, bytes.
    pub size: u32,
    /// Its content.
    pub hash: ObjectHash,
}

/// A message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Message {
    /// Who the neighbour is; said again and again, as a sign of life.
    Hello {
        /// The oldest version of the protocol that it speaks.
        version: u16,
        /// The neighbour.
        node: Uuid,
        /// What it is there for.
        role: Role,
        /// What people call it.
        name: String,
        /// What it found out.
        results: Option<ResultsRef>,
    },
    /// Which versions of the protocol the neighbour speaks; said before [`Hello`](Self::Hello). It goes as the
    /// [`Stored`](Self::Stored) of nobody, of which a neighbour that knows version 3 alone makes nothing.
    Speaks {
        /// The oldest.
        oldest: u16,
        /// The newest.
        newest: u16,
    },
    /// What can be asked for.
    State {
        /// It.
        version: MapVersion,
        /// The signature under it of the peer whose agent it is, where peers have keys.
        signature: Option<Signature>,
    },
    /// How much of an agent's map is on the neighbour's disk.
    Stored {
        /// Whose map.
        agent: Identity,
        /// Which version: the last that was complete there.
        begun: u64,
        /// Which version: the last that was complete there; 0 of none.
        revision: u64,
        /// Objects of the newest version that are not there yet.
        missing: u32,
    },
    /// A part of an object is wanted.
    Get {
        /// Which object.
        hash: ObjectHash,
        /// From which byte.
        offset: u32,
        /// How many bytes, at most [`MAX_PART`].
        length: u32,
    },
    /// A part of an object.
    Part {
        /// Which object.
        hash: ObjectHash,
        /// From which byte.
        offset: u32,
        /// The bytes.
        bytes: Vec<u8>,
    },
    /// An object that was asked for is not there, or not any more.
    Missing {
        /// Which object.
        hash: ObjectHash,
    },
    /// The neighbour will have nothing more to do with this one, and why.
    Refused {
        /// For people.
        reason: String,
    },
}

/// What goes before what on a link, the most urgent first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Priority {
    /// Signs of life, states, and what asks for objects.
    State,
    /// Parts of objects, in the order in which they were asked for.
    Object,
}

impl Message {
    /// How urgent it is. What is asked for is asked for in its order, so that all parts are alike.
    pub fn priority(&self) -> Priority {
        match self {
            Self::Part { .. } => Priority::Object,
            _ => Priority::State,
        }
    }

    /// As bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Writer::default();
        match self {
            Self::Hello { version, node, role, name, results } => {
                out.u8(0);
                out.u16(*version);
                out.bytes(node.as_bytes());
                out.u8(u8::from(*role == Role::Station));
                out.text(name);
                out.u8(results.is_some().into());
                if let Some(results) = results {
                    out.u64(results.revision);
                    out.u32(results.size);
                    out.bytes(&results.hash.0);
                }
            }
            Self::Speaks { oldest, newest } => {
                out.u8(2);
                out.identity(NOBODY);
                out.u64((*oldest).into());
                out.u64((*newest).into());
                out.u32(0);
            }
            Self::State { version, signature } => {
                out.u8(1);
                version.write(&mut out);
                out.u8(signature.is_some().into());
                signature.iter().for_each(|signature| out.bytes(signature));
            }
            Self::Stored { agent, begun, revision, missing } => {
                out.u8(2);
                out.identity(*agent);
                out.u64(*begun);
                out.u64(*revision);
                out.u32(*missing);
            }
            Self::Get { hash, offset, length } => {
                out.u8(3);
                out.bytes(&hash.0);
                out.u32(*offset);
                out.u32(*length);
            }
            Self::Part { hash, offset, bytes } => {
                out.u8(4);
                out.bytes(&hash.0);
                out.u32(*offset);
                out.bytes(bytes);
            }
            Self::Missing { hash } => {
                out.u8(5);
                out.bytes(&hash.0);
            }
            Self::Refused { reason } => {
                out.u8(6);
                out.text(reason);
            }
        }
        out.0
    }

    /// The inverse of [`to_bytes`](Self::to_bytes).
    ///
    /// # Errors
    /// When the bytes are no message.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Malformed> {
        if bytes.len() > MAX_MESSAGE {
            return Err(Malformed::Long(bytes.len() - MAX_MESSAGE));
        }
        let mut from = Reader::new(bytes);
        let message = match from.u8()? {
            0 => {
                let (version, node) = (from.u16()?, Uuid::from_bytes(from.array()?));
                let role = if flag(from.u8()?)? { Role::Station } else { Role::Agent };
                let name = from.text(MAX_NAME)?;
                let results = match flag(from.u8()?)? {
                    false => None,
                    true => Some(ResultsRef {
                        revision: from.u64()?,
                        size: within("the size of findings", from.u32()?, MAX_LIST)?,
                        hash: ObjectHash(from.array()?),
                    }),
                };
                Self::Hello { version, node, role, name, results }
            }
            1 => {
                let version = MapVersion {
                    agent: from.identity()?,
                    begun: from.u64()?,
                    revision: from.u64()?,
                    newest: from.u32()?,
                    size: within("the size of a manifest", from.u32()?, MAX_LIST)?,
                    hash: ObjectHash(from.array()?),
                };
                let signature = flag(from.u8()?)?.then(|| from.array()).transpose()?;
                Self::State { version, signature }
            }
            2 => {
                let (agent, begun, revision, missing) =
                    (from.identity()?, from.u64()?, from.u64()?, from.u32()?);
                let version = |number: u64| u16::try_from(number);
                match (version(begun), version(revision)) {
                    (Ok(oldest), Ok(newest)) if agent == NOBODY && missing == 0 => {
                        Self::Speaks { oldest, newest }
                    }
                    _ => Self::Stored { agent, begun, revision, missing },
                }
            }
            3 => Self::Get {
                hash: ObjectHash(from.array()?),
                offset: within("the offset of a part", from.u32()?, MAX_OBJECT)?,
                length: within("the length of a part", from.u32()?, MAX_PART as u32)?,
            },
            4 => Self::Part {
                hash: ObjectHash(from.array()?),
                offset: within("the offset of a part", from.u32()?, MAX_OBJECT)?,
                bytes: from.rest().to_vec(),
            },
            5 => Self::Missing { hash: ObjectHash(from.array()?) },
            6 => Self::Refused { reason: from.text(MAX_REASON)? },
            other => return Err(Malformed::Range("a kind of message", other.into())),
        };
        from.end()?;
        Ok(message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn messages() -> Vec<Message> {
        let agent = Identity { uuid: Uuid::from_u128(9), epoch: 1 };
        let hash = ObjectHash::of(b"an object");
        let results = Some(ResultsRef { revision: 3, size: 77, hash });
        let hello = |results| Message::Hello {
            version: VERSIONS[0],
            node: Uuid::from_u128(5),
            role: Role::Station,
            name: "ü".repeat(MAX_NAME / 2),
            results,
        };
        let version = MapVersion { agent, begun: 1 << 40, revision: 6, newest: 7, size: 8, hash };
        vec![
            hello(None),
            hello(results),
            Message::State { version, signature: None },
            Message::State { version, signature: Some([9; 64]) },
            Message::Stored { agent, begun: 1 << 40, revision: 6, missing: 2 },
            Message::Speaks { oldest: 3, newest: 7 },
            Message::Get { hash, offset: 4096, length: MAX_PART as u32 },
            Message::Part { hash, offset: 4096, bytes: vec![7; MAX_PART] },
            Message::Missing { hash },
            Message::Refused { reason: "it is full".into() },
        ]
    }

    #[test]
    fn messages_come_back_and_what_is_pushed_is_small() {
        for message in messages() {
            let bytes = message.to_bytes();
            assert_eq!(Message::from_bytes(&bytes), Ok(message.clone()));
            assert!(bytes.len() <= MAX_MESSAGE);
            let pushed =
                matches!(message, Message::Hello { .. } | Message::State { .. } | Message::Stored { .. });
            assert!(!pushed || bytes.len() <= 200, "{} bytes", bytes.len());
        }
    }

    /// Version 3 reads a kind, UUID, epoch, two numbers of eight bytes and one of four, and keeps it as an acknowledgement of the map of an agent
    /// that nobody has published.
    #[test]
    fn who_knows_version_3_alone_reads_which_versions_are_spoken_as_a_message_that_says_nothing() {
        let bytes = Message::Speaks { oldest: 3, newest: 4 }.to_bytes();
        let as_version_3 =
            [&[2][..], &[0; 16 + 4], &[3, 0, 0, 0, 0, 0, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0], &[0; 4]];
        assert_eq!(bytes, as_version_3.concat());
    }

    #[test]
    fn what_is_cut_or_asks_for_too_much_is_refused() {
        for message in messages().into_iter().filter(|message| !matches!(message, Message::Part { .. })) {
            let bytes = message.to_bytes();
            for end in 0..bytes.len() {
                assert!(Message::from_bytes(&bytes[..end]).is_err(), "{message:?} cut at {end}");
            }
            assert!(Message::from_bytes(&[bytes, vec![0]].concat()).is_err());
        }
        let hash = ObjectHash::of(b"");
        for (offset, length) in [(u32::MAX, 1), (0, u32::MAX)] {
            assert!(Message::from_bytes(&Message::Get { hash, offset, length }.to_bytes()).is_err());
        }
        assert!(Message::from_bytes(&vec![4; MAX_MESSAGE + 1]).is_err());
    }
}
