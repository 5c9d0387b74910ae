//! Values that several hold and one may change.

use geometry::{Buffer, Swap};
use std::ops::{Deref, DerefMut};
use std::sync::Arc;

/// A value that is cheap to hand on: copies share it until one of them is changed, which then gets its own.
///
/// So a part of a map can be read elsewhere (tracked against, written to a file, shown) while it is worked on.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Shared<T>(Arc<T>);

/// Bytes that several hold, in memory or swapped out.
pub type SharedBytes = Shared<Buffer<u8>>;

impl<T> From<T> for Shared<T> {
    fn from(value: T) -> Self {
        Self(Arc::new(value))
    }
}

impl From<Vec<u8>> for SharedBytes {
    fn from(bytes: Vec<u8>) -> Self {
        Buffer::from(bytes).into()
    }
}

impl SharedBytes {
    /// Bytes that `swap` keeps, where it has room for them.
    pub fn kept_by(swap: Option<&dyn Swap>, bytes: Vec<u8>) -> Self {
        let mut bytes = Self::from(bytes);
        swap.into_iter().for_each(|swap| bytes.swap_out(swap));
        bytes
    }

    /// Keeps the bytes where `swap` has room for them and gives back the memory of them, until they are looked at again.
    /// Copies of before stay where they are.
    pub fn swap_out(&mut self, swap: &dyn Swap) {
        if let Some(kept) = self.swapped_out(swap) {
            kept.rest();
            *self = kept.into();
        }
    }
}

impl<T> Deref for Shared<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}

impl<T: Clone> DerefMut for Shared<T> {
    fn deref_mut(&mut self) -> &mut T {
        Arc::make_mut(&mut self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_share_until_one_is_changed() {
        let mut first: Shared<Vec<i32>> = vec![1, 2].into();
        let second = first.clone();
        assert!(std::ptr::eq(&*first, &*second));
        first.push(3);
        assert_eq!((&*first, &*second), (&vec![1, 2, 3], &vec![1, 2]));
        let alone: *const Vec<i32> = &*first;
        first.push(4);
        assert!(std::ptr::eq(alone, &*first), "what nobody else holds is changed in place");
    }
}
