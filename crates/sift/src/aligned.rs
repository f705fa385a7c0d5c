//! Buffers that begin at a cache line.

use std::ops::{Deref, DerefMut};

/// Floats in a cache line.
const LINE: usize = 16;

/// Floats of which the first lies at the begin of a cache line, so that vectors at multiples of their length never lie on two.
/// That is for speed only: nothing goes wrong where the memory cannot be had so.
#[derive(Debug, Default)]
pub(crate) struct Aligned {
    memory: Vec<f32>,
    begin: usize,
    len: usize,
}

impl Aligned {
    /// Takes a length and keeps its memory. What the values are is left open.
    pub(crate) fn resize(&mut self, len: usize) {
        if self.memory.len() < len + LINE {
            self.memory.resize(len + LINE, 0.0);
        }
        let bytes = LINE * size_of::<f32>();
        self.begin = self.memory.as_ptr().align_offset(bytes).min(LINE);
        self.len = len;
    }
}

impl Deref for Aligned {
    type Target = [f32];

    #[inline(always)]
    fn deref(&self) -> &[f32] {
        &self.memory[self.begin..self.begin + self.len]
    }
}

impl DerefMut for Aligned {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.memory[self.begin..self.begin + self.len]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_kept_to_and_memory_is_kept() {
        let mut aligned = Aligned::default();
        for len in [5, 1000, 17, 0, 16] {
            aligned.resize(len);
            assert_eq!(aligned.len(), len);
            if let Some(last) = aligned.last_mut() {
                *last = 7.0;
                assert_eq!(aligned[len - 1], 7.0);
            }
            assert!(aligned.memory.len() >= len);
        }
        assert_eq!(aligned.memory.len(), 1000 + LINE);
    }
}
