//! Arrays of numbers, in memory or swapped out ([`Swap`]).

use bytemuck::Pod;
use std::fmt;
use std::ops::{Deref, DerefMut};
use std::sync::Arc;

/// Keeps bytes outside memory, in files for example.
pub trait Swap: Send + Sync {
    /// Keeps a copy of `bytes`, at an address that is a multiple of 16; `None` where there is no room. The caller
    /// then keeps them in memory.
    fn keep(&self, bytes: &[u8]) -> Option<Arc<dyn Swapped>>;
}

/// Bytes that a [`Swap`] keeps.
///
/// # Safety
/// [`bytes`](Self::bytes) are the same, at the same address, for as long as the value lives, whatever else is called.
pub unsafe trait Swapped: Send + Sync {
    /// The bytes; they are read when they are used.
    fn bytes(&self) -> &[u8];

    /// Gives their memory back, because they are not needed soon. They can be read again at any time.
    fn rest(&self);
}

/// An array of values, like a `Vec`. Values that were [swapped out](Self::swapped_out) are copied back before they
/// change.
pub struct Buffer<T> {
    /// Of what `owner` has, for as long as it does.
    start: *const T,
    len: usize,
    owner: Owner<T>,
}

enum Owner<T> {
    Memory(Vec<T>),
    Swap(Arc<dyn Swapped>),
}

// Safety: what is pointed at is the owner's, who may go to other threads and be looked at from several.
unsafe impl<T: Send> Send for Buffer<T> {}
unsafe impl<T: Sync> Sync for Buffer<T> {}

impl<T> From<Vec<T>> for Buffer<T> {
    fn from(values: Vec<T>) -> Self {
        Self { start: values.as_ptr(), len: values.len(), owner: Owner::Memory(values) }
    }
}

impl<T> Deref for Buffer<T> {
    type Target = [T];

    #[inline]
    fn deref(&self) -> &[T] {
        // Safety: the owner's values, which change by `deref_mut` and `change` alone, who need them for themselves.
        unsafe { std::slice::from_raw_parts(self.start, self.len) }
    }
}

impl<T: Copy> Buffer<T> {
    /// Adds a value at the end.
    pub fn push(&mut self, value: T) {
        self.change(|values| values.push(value));
    }

    /// Drops the values behind the first `len`.
    pub fn truncate(&mut self, len: usize) {
        self.change(|values| values.truncate(len));
    }

    /// Changes the values, in memory of their own.
    fn change(&mut self, change: impl FnOnce(&mut Vec<T>)) {
        let mut values = match std::mem::take(self) {
            Self { owner: Owner::Memory(values), .. } => values,
            swapped => swapped.to_vec(),
        };
        change(&mut values);
        *self = values.into();
    }
}

impl<T: Copy> DerefMut for Buffer<T> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [T] {
        if let Owner::Swap(_) = self.owner {
            self.change(|_| ());
        }
        match &mut self.owner {
            Owner::Memory(values) => values,
            Owner::Swap(_) => unreachable!("what is changed is in memory"),
        }
    }
}

impl<T: Pod> Buffer<T> {
    /// The same values, kept by `swap`; `None` where it has no room, or has them already.
    pub fn swapped_out(&self, swap: &dyn Swap) -> Option<Self> {
        let Owner::Memory(values) = &self.owner else { return None };
        let kept = swap.keep(bytemuck::cast_slice(values))?;
        let (start, len) = {
            let same: &[T] = bytemuck::try_cast_slice(kept.bytes()).ok()?;
            (same.as_ptr(), same.len())
        };
        (len == values.len()).then_some(Self { start, len, owner: Owner::Swap(kept) })
    }
}

impl<T> Buffer<T> {
    /// Gives back the memory of what is swapped out, until it is looked at again.
    pub fn rest(&self) {
        if let Owner::Swap(kept) = &self.owner {
            kept.rest();
        }
    }
}

impl<T: Clone> Clone for Buffer<T> {
    fn clone(&self) -> Self {
        match &self.owner {
            Owner::Memory(values) => values.clone().into(),
            Owner::Swap(kept) => {
                Self { start: self.start, len: self.len, owner: Owner::Swap(Arc::clone(kept)) }
            }
        }
    }
}

impl<T> Default for Buffer<T> {
    fn default() -> Self {
        Vec::new().into()
    }
}

impl<T: fmt::Debug> fmt::Debug for Buffer<T> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        self.deref().fmt(f)
    }
}

impl<T: PartialEq> PartialEq for Buffer<T> {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl<T: Eq> Eq for Buffer<T> {}

impl<T> FromIterator<T> for Buffer<T> {
    fn from_iter<I: IntoIterator<Item = T>>(values: I) -> Self {
        values.into_iter().collect::<Vec<T>>().into()
    }
}

impl<'a, T> IntoIterator for &'a Buffer<T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Keeps so many bytes in memory.
    struct Room {
        left: AtomicUsize,
        rested: Arc<AtomicUsize>,
    }

    struct InMemory {
        // Of the largest alignment asked for.
        words: Box<[u128]>,
        len: usize,
        rested: Arc<AtomicUsize>,
    }

    unsafe impl Swapped for InMemory {
        fn bytes(&self) -> &[u8] {
            unsafe { std::slice::from_raw_parts(self.words.as_ptr().cast(), self.len) }
        }

        fn rest(&self) {
            self.rested.fetch_add(1, Ordering::Relaxed);
        }
    }

    impl Swap for Room {
        fn keep(&self, bytes: &[u8]) -> Option<Arc<dyn Swapped>> {
            let take = |left: usize| left.checked_sub(bytes.len());
            self.left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, take).ok()?;
            let word = |piece: &[u8]| {
                let mut word = [0; 16];
                word[..piece.len()].copy_from_slice(piece);
                u128::from_ne_bytes(word)
            };
            let words = bytes.chunks(16).map(word).collect();
            Some(Arc::new(InMemory { words, len: bytes.len(), rested: Arc::clone(&self.rested) }))
        }
    }

    fn room(bytes: usize) -> Room {
        Room { left: AtomicUsize::new(bytes), rested: Arc::default() }
    }

    #[test]
    fn what_is_swapped_out_reads_the_same() {
        let room = room(1000);
        let values: Buffer<f32> = (0..77).map(|i| i as f32 * 0.3 - 5.0).collect();
        let out = values.swapped_out(&room).unwrap();
        assert_eq!(out, values);
        out.rest();
        assert_eq!((room.rested.load(Ordering::Relaxed), out.clone()), (1, values));
        assert!(out.swapped_out(&room).is_none(), "it is there already");
        drop(room);
        assert_eq!(out[76], 76.0f32 * 0.3 - 5.0, "what is kept outlives who keeps it");
    }

    #[test]
    fn without_room_values_stay() {
        let values: Buffer<u32> = (0..77).collect();
        assert!(values.swapped_out(&room(77 * 4 - 1)).is_none());
        assert!(values.swapped_out(&room(77 * 4)).is_some());
        let empty = Buffer::<u32>::default();
        assert_eq!(empty.swapped_out(&room(0)).unwrap_or_default(), empty);
    }

    #[test]
    fn what_is_changed_comes_back_and_copies_stay() {
        let values: Buffer<u8> = (0..20).collect();
        let mut out = values.swapped_out(&room(20)).unwrap();
        let copy = out.clone();
        out[3] = 99;
        out.push(7);
        out.truncate(18);
        assert_eq!((out[3], out.len(), copy[3], copy.len()), (99, 18, 3, 20));
        let mut own = values.clone();
        own.push(1);
        assert_eq!((own.len(), values.len(), own[20]), (21, 20, 1));
    }
}
