//! What a node is told and what it wants done.

use super::Quota;
use crate::hash::ObjectHash;
use crate::keys::{Peer, Signer};
use crate::manifest::{Entry, Kind};
use crate::merge_results::MergeResults;
use crate::publishing::Publication;
use crate::wire::{Priority, Role};
use map::{Identity, Uuid};
use std::sync::Arc;

/// A connection to a neighbour, as its transport calls it; a new one for each time it is opened.
pub type LinkId = u64;

/// Who one is, and what one allows others.
#[derive(Clone, Debug)]
pub struct Config {
    /// Oneself: the same after a restart.
    pub node: Uuid,
    /// What for.
    pub role: Role,
    /// What people call it; at most 64 bytes are told.
    pub name: String,
    /// What the maps of another may take.
    pub quota: Quota,
    /// Of maps of others only lists and places of keyframes come by themselves, and all else once it is asked for by
    /// [`Event::Prefer`].
    pub waits: bool,
    /// The oldest and the newest version of the protocol that is spoken, [`VERSIONS`](crate::wire::VERSIONS).
    pub versions: [u16; 2],
    /// Signs what is told, where peers have keys: then of others only what is signed is believed.
    pub signer: Option<Arc<Signer>>,
}

/// What happens to a node.
#[derive(Debug)]
pub enum Event {
    /// A link was opened, by whoever dialled.
    Up {
        /// Its name from now on.
        link: LinkId,
        /// Where the other one is, for people.
        address: String,
        /// Whose certificate it showed, where peers have keys.
        peer: Option<Peer>,
    },
    /// A link could not be opened or broke, and why.
    Trouble(String),
    /// Nobody answers where it was dialled; it is dialled again.
    Unanswered {
        /// Where.
        address: String,
        /// What the system says.
        reason: String,
    },
    /// A link is gone.
    Down {
        /// Which.
        link: LinkId,
    },
    /// A message came.
    Received {
        /// On which link.
        link: LinkId,
        /// The message.
        bytes: Vec<u8>,
    },
    /// Time passed. Comes ten times a second or more often.
    Tick,
    /// An agent who works here has a new version of its map.
    Publish(Box<Publication>),
    /// These objects of an agent's keyframes are wanted before others.
    Prefer {
        /// Whose.
        agent: Identity,
        /// Their kinds and the keyframes' numbers, the most wanted first.
        objects: Vec<(Kind, u32)>,
        /// Whether the others are wanted too, after them.
        rest: bool,
    },
    /// What a neighbour told of this agent is not to be believed.
    Ban {
        /// Whose map it told.
        agent: Identity,
        /// Why.
        reason: String,
    },
    /// Something new was found out about where agents are; `revision` is larger than before.
    Results {
        /// Which version it is.
        revision: u64,
        /// What; each neighbour is told what concerns the agents that it tells.
        found: Arc<MergeResults>,
    },
}

/// What a node wants done.
#[derive(Debug)]
pub enum Action {
    /// A message is to be sent; it may be dropped where the link has no room.
    Send {
        /// On which link.
        link: LinkId,
        /// What goes before what.
        priority: Priority,
        /// The message.
        bytes: Vec<u8>,
    },
    /// A part of an object that is told is to be read and sent as [`Message::Part`](crate::wire::Message::Part), or
    /// [`Message::Missing`](crate::wire::Message::Missing) where it is not there.
    Serve {
        /// On which link.
        link: LinkId,
        /// Which object.
        hash: ObjectHash,
        /// From which byte.
        offset: u32,
        /// How many bytes.
        length: u32,
    },
    /// A link is to be closed.
    Close {
        /// Which.
        link: LinkId,
        /// Why, for people.
        reason: String,
    },
    /// Something people or other parts of the program may want to know.
    Notify(Notice),
}

/// What happened, for people and other parts of the program.
#[derive(Clone, Debug)]
pub enum Notice {
    /// A neighbour said who it is.
    Connected {
        /// What people call it.
        name: String,
        /// Where it is.
        address: String,
    },
    /// A neighbour is not there any more.
    Disconnected {
        /// What people call it.
        name: String,
        /// How that was noticed.
        reason: String,
    },
    /// Nobody answers where it was dialled, and did before or never was.
    Unanswered {
        /// Where.
        address: String,
        /// What the system says.
        reason: String,
    },
    /// There is more of an agent's map than before.
    Map(MapSnapshot),
    /// A neighbour found something out about where agents are.
    Results {
        /// Who.
        from: Uuid,
        /// Whose node that is, where peers have keys.
        peer: Option<Uuid>,
        /// What, not looked at.
        bytes: Vec<u8>,
    },
    /// A neighbour acknowledges that all of an own map up to this version is on its disk.
    Stored {
        /// Who.
        by: String,
        /// Whose map.
        agent: Identity,
        /// Which version, see [`MapVersion::order`](crate::wire::MapVersion::order).
        version: (u64, u64),
    },
    /// A version of an own map is on the disk, and told.
    Published {
        /// Whose map.
        agent: Identity,
        /// Which version.
        version: (u64, u64),
    },
    /// Something of an own map is not kept, and so not told: all of it is to be published anew.
    Unkept,
    /// Something was refused, by this one or the other, or did not work.
    Trouble(String),
}

/// How much of another's map is here.
#[derive(Clone, Debug)]
pub struct MapSnapshot {
    /// Whose.
    pub agent: Identity,
    /// When the agent began to tell it, milliseconds since 1970.
    pub begun: u64,
    /// All objects of its newest version.
    pub entries: Arc<[Entry]>,
    /// How many of them are not here yet, but for those that only stand in for others.
    pub missing: usize,
    /// How many came so far: more, when there is more of it.
    pub came: u64,
    /// Whether the agent's run has ended.
    pub finished: bool,
    /// Whether what is missing can be had by now: there is a link to whoever tells it, and something was heard on it for
    /// the last [`SILENCE`](super::SILENCE).
    pub is_near: bool,
}
