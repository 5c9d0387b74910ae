//! Common maps as files: the manifest of what one is made of, what its agents are called, and the files of each group.

pub(crate) mod groups;
pub(crate) mod manifest;
pub(crate) mod names;
pub(crate) mod opened;
