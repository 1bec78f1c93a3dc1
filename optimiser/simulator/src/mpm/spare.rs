//! The memory of states, which goes from one state to the next.
//!
//! A gradient makes and drops thousands of states, so their buffers are reused: touching fresh pages costs more than the
//! work done in them, and memory freed by one thread stays in that thread's allocator cache.

use crate::mpm::layout::{BLOCK_NODES, Nodes};
use crate::mpm::particles::Group;
use crate::real::Real;

/// Vectors that nobody needs at the moment.
#[derive(Debug)]
pub(crate) struct BufferPool<T> {
    groups: Vec<Vec<Group<T>>>,
    nodes: Vec<Vec<Nodes<T>>>,
}

/// What a state takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Size {
    pub(crate) groups: usize,
    /// Blocks of nodes, in each vector for what is on its grid.
    pub(crate) nodes: usize,
    /// Such vectors.
    pub(crate) vectors: usize,
    /// Bytes beside these vectors.
    pub(crate) besides: u64,
}

impl<T: Real> BufferPool<T> {
    /// None.
    pub(crate) fn empty() -> Self {
        Self { groups: Vec::new(), nodes: Vec::new() }
    }

    /// Memory for so many groups; what is in them is not to be looked at.
    pub(crate) fn acquire_groups(&mut self, count: usize) -> Vec<Group<T>> {
        take(&mut self.groups, count, Group::ZERO)
    }

    /// Makes `groups` `count` long. If it has no room for so many, a spare vector that has, or a new one, takes its place, and the
    /// old one becomes spare. What is in it afterwards is not to be looked at.
    pub(crate) fn fit_groups(&mut self, groups: &mut Vec<Group<T>>, count: usize) {
        if groups.capacity() < count {
            let larger = self.acquire_groups(count);
            self.return_groups(std::mem::replace(groups, larger));
        }
        fit(groups, count, Group::ZERO);
    }

    /// The same for what is on blocks of nodes.
    pub(crate) fn fit_nodes(&mut self, nodes: &mut Vec<Nodes<T>>, count: usize) {
        const fn zero<T: Real>() -> Nodes<T> {
            [[T::ZERO; 4]; BLOCK_NODES]
        }
        if nodes.capacity() < count {
            let larger = take(&mut self.nodes, count, zero());
            self.return_nodes(std::mem::replace(nodes, larger));
        }
        fit(nodes, count, zero());
    }

    pub(crate) fn return_groups(&mut self, groups: Vec<Group<T>>) {
        give(&mut self.groups, groups);
    }

    pub(crate) fn return_nodes(&mut self, nodes: Vec<Nodes<T>>) {
        give(&mut self.nodes, nodes);
    }

    /// All bytes.
    pub(crate) fn bytes(&self) -> u64 {
        (bytes(&self.groups) + bytes(&self.nodes)) as u64
    }

    /// States that fit into the buffers here and `left` more bytes. A state needs one buffer of groups and some of nodes, each
    /// long enough.
    pub(crate) fn states(&self, size: Size, left: u64) -> usize {
        let vectors = size.vectors as u64;
        let kinds = [
            (enough(&self.groups, size.groups), 1, state_bytes::<T>(Size { nodes: 0, besides: 0, ..size })),
            (
                enough(&self.nodes, size.nodes),
                vectors,
                state_bytes::<T>(Size { groups: 0, besides: 0, ..size }) / vectors,
            ),
        ];
        let cost = |states: u64| {
            let new = |(spare, each, bytes): &(u64, u64, u64)| (states * each).saturating_sub(*spare) * bytes;
            kinds.iter().map(new).sum::<u64>() + states * size.besides
        };
        let (mut low, mut high) = (0, 1);
        while cost(high) <= left && high < 1 << 24 {
            (low, high) = (high, 2 * high);
        }
        while high - low > 1 {
            let middle = low + (high - low) / 2;
            if cost(middle) <= left { low = middle } else { high = middle }
        }
        low as usize
    }
}

/// Bytes of a state in memory that is new.
pub(crate) fn state_bytes<T: Real>(size: Size) -> u64 {
    let groups = roomy(size.groups) * size_of::<Group<T>>();
    let nodes = size.vectors * roomy(size.nodes) * size_of::<Nodes<T>>();
    (groups + nodes) as u64 + size.besides
}

/// Room for so many elements and a few more, in sixteenths of a power of two: lengths that change a little from one time to the
/// next then need the same room.
fn roomy(length: usize) -> usize {
    length.next_multiple_of((length.next_power_of_two() / 16).max(1))
}

/// So many elements, in the memory that is already there or in more, which is taken at once and as a whole: it counts from now
/// on, not when somebody happens to write there. A vector that is left to grow by itself takes twice the memory at the
/// first element more.
pub(crate) fn fit<E: Clone>(vector: &mut Vec<E>, length: usize, with: E) {
    if vector.capacity() < length {
        vector.reserve_exact(roomy(length) - vector.len());
        vector.resize(vector.capacity(), with.clone());
    }
    vector.resize(length, with);
}

/// One that is long enough; those that are not have been outgrown, and go back to the allocator.
fn take<E: Clone>(spare: &mut Vec<Vec<E>>, count: usize, with: E) -> Vec<E> {
    while let Some(mut vector) = spare.pop() {
        if vector.capacity() >= count {
            vector.resize(count, with);
            return vector;
        }
    }
    let mut vector = Vec::new();
    fit(&mut vector, count, with);
    vector
}

fn give<E>(spare: &mut Vec<Vec<E>>, vector: Vec<E>) {
    if vector.capacity() > 0 {
        spare.push(vector);
    }
}

fn enough<E>(spare: &[Vec<E>], count: usize) -> u64 {
    spare.iter().filter(|vector| vector.capacity() >= count).count() as u64
}

fn bytes<E>(spare: &[Vec<E>]) -> usize {
    spare.iter().map(|vector| vector.capacity() * size_of::<E>()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vector_takes_little_more_memory_than_it_needs_and_takes_it_at_once() {
        let mut vector: Vec<u64> = Vec::with_capacity(1_000);
        fit(&mut vector, 1_001, 7);
        assert_eq!(vector, [7; 1_001]);
        assert_eq!(vector.capacity(), 1_024);
        fit(&mut vector, 10, 8);
        assert_eq!(vector, [7; 10]);
        fit(&mut vector, 1_024, 9);
        assert_eq!((vector[10], vector[1_023], vector.capacity()), (9, 9, 1_024));
        for length in [0, 1, 15, 16, 17, 33, 10_000] {
            assert!((length..=length + length / 8).contains(&roomy(length)), "{length}: {}", roomy(length));
        }
    }

    #[test]
    fn memory_changes_hands_until_it_is_outgrown() {
        let mut spare: BufferPool<f32> = BufferPool::empty();
        let first = spare.acquire_groups(100);
        let place = first.as_ptr();
        spare.return_groups(first);
        let mut second = spare.acquire_groups(90);
        assert_eq!((second.len(), second.as_ptr(), spare.bytes()), (90, place, 0));
        spare.fit_groups(&mut second, 100);
        assert_eq!((second.len(), second.as_ptr()), (100, place));
        // Too short: it is spare, and gone when the next one asks for more than it has.
        spare.fit_groups(&mut second, 1_000);
        assert_eq!((second.len(), enough(&spare.groups, 100), enough(&spare.groups, 200)), (1_000, 1, 0));
        spare.acquire_groups(200);
        assert_eq!(spare.bytes(), 0);
    }

    #[test]
    fn states_are_counted_by_what_they_lack() {
        let mut spare: BufferPool<f32> = BufferPool::empty();
        let size = Size { groups: 64, nodes: 32, vectors: 2, besides: 100 };
        let one = state_bytes::<f32>(size);
        assert_eq!(
            (spare.states(size, one - 1), spare.states(size, one), spare.states(size, 5 * one)),
            (0, 1, 5)
        );
        // Groups for a second state, but no nodes.
        let groups = spare.acquire_groups(64);
        spare.return_groups(groups);
        assert_eq!(spare.states(size, 100), 0);
        let mut nodes = Vec::new();
        for _ in 0..2 {
            spare.fit_nodes(&mut nodes, 32);
            spare.return_nodes(std::mem::take(&mut nodes));
            spare.nodes.push(Vec::with_capacity(32));
        }
        assert_eq!(spare.states(size, 100), 1);
        assert_eq!(spare.states(size, 100 + one), 2);
        // Larger ones find nothing that would do.
        assert_eq!(spare.states(Size { groups: 65, nodes: 33, ..size }, one), 0);
    }
}
