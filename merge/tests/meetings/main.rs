//! Meetings of agents from images to the common map, with the truth known: agents track recordings rendered in one
//! yard, their maps are merged, taken apart, moved about and made unusable.

mod chain;
mod continuing;
mod direct;
mod doubles;
mod frames;
mod merging;
mod refusals;
mod rendered;
mod yard;
