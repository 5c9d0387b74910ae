//! Files of messages that are read on past their damaged pieces.

use std::collections::VecDeque;

/// The content of the piece that was read last.
pub struct Found<M, E> {
    /// Messages that were not taken yet, in the order of the file.
    pub messages: VecDeque<M>,
    /// The damage after them.
    pub damage: Option<E>,
    /// Whether it was the last piece.
    is_last: bool,
}

impl<M, E> Default for Found<M, E> {
    fn default() -> Self {
        Self { messages: VecDeque::new(), damage: None, is_last: false }
    }
}

/// A file read piece by piece: record by record, or chunk by chunk.
pub trait Pieces {
    /// The message type of a piece.
    type Message;
    /// The damage of a piece.
    type Damage;

    /// Reads the next piece into [`Self::found`]; false behind the last.
    ///
    /// # Errors
    /// When the piece is damaged so that it is not known where the next begins.
    fn advance(&mut self) -> Result<bool, Self::Damage>;

    /// Continues at the next piece that an index knows; false if there is none.
    fn go_on(&mut self) -> bool;

    /// The content of the last piece.
    fn found(&mut self) -> &mut Found<Self::Message, Self::Damage>;

    /// The next message, including those of a damaged piece before its damage. An error is a damage; more messages
    /// may follow.
    fn next_message(&mut self) -> Option<Result<Self::Message, Self::Damage>> {
        loop {
            let found = self.found();
            if let Some(message) = found.messages.pop_front() {
                return Some(Ok(message));
            }
            if let Some(damage) = found.damage.take() {
                return Some(Err(damage));
            }
            if found.is_last {
                return None;
            }
            let is_last = match self.advance() {
                Ok(more) => !more,
                Err(damage) => {
                    self.found().damage = Some(damage);
                    !self.go_on()
                }
            };
            self.found().is_last = is_last;
        }
    }
}
