//! Lists whose memory is used again: what an image leaves for its gradient is as large as that of
//! the image before, and asking the system for it takes as long as filling it.

use std::sync::Mutex;

/// At most so many bytes are kept of each kind.
const MOST_BYTES: usize = 64 << 20;

/// Lists, and the bytes of their memory.
type Lists<T> = (Vec<Vec<T>>, usize);

/// Lists that are not in use.
#[derive(Debug)]
pub(super) struct Spare<T>(Mutex<Lists<T>>);

impl<T> Spare<T> {
    pub(super) const fn new() -> Self {
        Self(Mutex::new((Vec::new(), 0)))
    }

    /// A list, with what it held. Nobody is waited for: a process may be a copy of one that held the
    /// lock.
    pub(super) fn take(&self) -> Vec<T> {
        let Ok(mut spare) = self.0.try_lock() else { return Vec::new() };
        let list = spare.0.pop().unwrap_or_default();
        spare.1 -= list.capacity() * size_of::<T>();
        list
    }

    pub(super) fn give(&self, list: Vec<T>) {
        let bytes = list.capacity() * size_of::<T>();
        if let Ok(mut spare) = self.0.try_lock()
            && bytes > 0
            && spare.1 + bytes <= MOST_BYTES
        {
            spare.0.push(list);
            spare.1 += bytes;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_comes_back_up_to_a_limit() {
        let spare = Spare::<u64>::new();
        assert_eq!(spare.take().capacity(), 0);
        let mut list = Vec::with_capacity(1000);
        list.push(1);
        let (place, capacity) = (list.as_ptr(), list.capacity());
        spare.give(list);
        let again = spare.take();
        assert_eq!((again.as_ptr(), again.capacity(), again.len()), (place, capacity, 1));
        spare.give(Vec::with_capacity(MOST_BYTES / 8 + 1));
        assert_eq!(spare.take().capacity(), 0);
    }
}
