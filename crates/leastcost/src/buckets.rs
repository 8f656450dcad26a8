//! Monotone priority queue of integer costs: Dial's circular buckets (1969), each a chain of small blocks in one pool.
//!
//! The range of costs in a bucket (its span) is a power of two that is at most the cost of any edge, so all costs in
//! the front bucket are final and its nodes may be settled in any order (Dinitz 1978). With span 1 the order is that of
//! the costs themselves. Blocks keep the entries of one bucket together in memory, and the pool needs little more
//! memory than the open entries.

/// Block number that marks the absence of a block.
const END: u32 = u32::MAX;

/// Priority queue of nodes, sorted by cost into buckets.
#[derive(Debug)]
pub(crate) struct Buckets {
    /// Newest block of each bucket, and the number of used entries in that block.
    tails: Vec<(u32, u32)>,
    /// One bit per bucket, set if the bucket is not empty, so that 64 empty buckets are skipped at a time.
    filled: Vec<u64>,
    pool: Vec<u32>,
    /// For each used block, the previous block of the same bucket; for each free block, the next free block.
    before: Vec<u32>,
    free: u32,
    block_log2: u32,
    span_log2: u32,
    num_blocks_open: usize,
    /// Number of the front bucket (the one with the lowest costs), counted from cost 0 and not modulo the circle.
    front: u64,
}

/// Block of entries that was taken from the front bucket; the caller returns the block to the pool after use.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Block {
    number: u32,
    first: usize,
    /// Number of entries in this block.
    pub(crate) len: usize,
}

impl Buckets {
    /// Create a queue whose open costs differ by at most `reach`; one bucket holds 2^`span_log2` costs.
    pub(crate) fn new(reach: u64, span_log2: u32) -> Self {
        // The queue has two buckets more than `reach` fills: the front bucket, and the bucket in which the range of the
        // largest cost may begin.
        let num_buckets = ((reach >> span_log2) as usize + 2)
            .next_power_of_two()
            .max(64);
        Self {
            tails: vec![(END, 0); num_buckets],
            filled: vec![0; num_buckets / 64],
            pool: Vec::new(),
            before: Vec::new(),
            free: END,
            // With few buckets each bucket has many entries and large blocks are used, with many buckets small blocks.
            block_log2: if num_buckets > 1024 { 6 } else { 9 },
            span_log2,
            num_blocks_open: 0,
            front: 0,
        }
    }

    /// Return the lowest cost that belongs to the queue's first bucket (the front).
    pub(crate) const fn front_cost(&self) -> u64 {
        self.front << self.span_log2
    }

    /// Return the number of the queue's bucket to which a cost belongs.
    pub(crate) const fn bucket_of(&self, cost: u64) -> u64 {
        cost >> self.span_log2
    }

    /// Return the memory that the queue has allocated, in bytes.
    pub(crate) fn num_bytes(&self) -> usize {
        8 * (self.tails.capacity() + self.filled.capacity())
            + 4 * (self.pool.capacity() + self.before.capacity())
    }

    #[inline]
    pub(crate) fn push(&mut self, cost: u64, node: u32) {
        let bucket = (cost >> self.span_log2) as usize & (self.tails.len() - 1);
        let (mut block, mut len) = self.tails[bucket];
        if block == END || len >> self.block_log2 != 0 {
            block = self.new_block(block);
            len = 0;
            self.filled[bucket / 64] |= 1 << (bucket % 64);
        }
        self.pool[((block as usize) << self.block_log2) + len as usize] = node;
        self.tails[bucket] = (block, len + 1);
    }

    #[cold]
    fn new_block(&mut self, before: u32) -> u32 {
        self.num_blocks_open += 1;
        let mut block = self.free;
        if block == END {
            block = self.before.len() as u32;
            let size = 1 << self.block_log2;
            if self.pool.len() + size > self.pool.capacity() {
                // The pool grows by a quarter, so it is only slightly larger than the largest number of open entries.
                self.pool
                    .reserve_exact((self.pool.len() / 4).max(16 * size));
            }
            self.pool.resize(self.pool.len() + size, 0);
            self.before.push(before);
        } else {
            self.free = self.before[block as usize];
            self.before[block as usize] = before;
        }
        block
    }

    /// Move the front (the bucket being emptied) to the next bucket that is not empty; return false if there is none.
    pub(crate) fn advance(&mut self) -> bool {
        if self.num_blocks_open == 0 {
            return false;
        }
        let mask = self.tails.len() - 1;
        let mut bucket = self.front as usize & mask;
        loop {
            let ahead = self.filled[bucket / 64] >> (bucket % 64);
            if ahead != 0 {
                self.front += u64::from(ahead.trailing_zeros());
                return true;
            }
            let skip = 64 - bucket % 64;
            self.front += skip as u64;
            bucket = (bucket + skip) & mask;
        }
    }

    /// Remove and return a block of the front bucket; `None` if the front bucket is empty.
    ///
    /// Entries that are pushed to the front bucket in the meantime are returned by a later call.
    pub(crate) fn take(&mut self) -> Option<Block> {
        let bucket = self.front as usize & (self.tails.len() - 1);
        let (number, len) = self.tails[bucket];
        if number == END {
            return None;
        }
        let before = self.before[number as usize];
        self.tails[bucket] = (before, 1 << self.block_log2);
        if before == END {
            self.filled[bucket / 64] &= !(1 << (bucket % 64));
        }
        Some(Block {
            number,
            first: (number as usize) << self.block_log2,
            len: len as usize,
        })
    }

    /// Remove and return the newest entry of the front bucket; `None` if the front bucket is empty.
    #[inline]
    pub(crate) fn pop(&mut self) -> Option<u32> {
        let bucket = self.front as usize & (self.tails.len() - 1);
        let (number, len) = self.tails[bucket];
        if number == END {
            return None;
        }
        let node = self.pool[((number as usize) << self.block_log2) + len as usize - 1];
        self.tails[bucket].1 = len - 1;
        if len == 1
            && let Some(block) = self.take()
        {
            self.give_back(block);
        }
        Some(node)
    }

    #[inline]
    pub(crate) fn entry(&self, block: Block, at: usize) -> u32 {
        self.pool[block.first + at]
    }

    pub(crate) fn give_back(&mut self, block: Block) {
        self.before[block.number as usize] = self.free;
        self.free = block.number;
        self.num_blocks_open -= 1;
    }
}
