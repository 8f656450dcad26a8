//! A monotone queue of whole-number costs: Dial's circle of buckets (1969), each a chain of small blocks in one pool.
//!
//! A bucket spans a power of two of costs that no edge is cheaper than, so all that is in the front bucket is final and
//! may be settled in any order (Dinitz 1978); with span 1 the order is that of the costs themselves. Blocks keep the
//! entries of one bucket together in memory, and the pool holds little more than what is open.

/// No block.
const END: u32 = u32::MAX;

/// Open nodes by cost.
#[derive(Debug)]
pub(crate) struct Buckets {
    /// Newest block of each bucket, and how many of its entries are taken.
    tails: Vec<(u32, u32)>,
    /// One bit per bucket that holds something: empty stretches are passed 64 buckets at a time.
    filled: Vec<u64>,
    pool: Vec<u32>,
    /// The block before each in its bucket, or the next free one.
    before: Vec<u32>,
    free: u32,
    block_log2: u32,
    span_log2: u32,
    num_blocks_open: usize,
    /// Number of the front bucket, counted from cost 0 and not in the circle.
    front: u64,
}

/// Entries that were taken from the front bucket; to be given back when they are done with.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Block {
    number: u32,
    first: usize,
    /// Entries in it.
    pub(crate) len: usize,
}

impl Buckets {
    /// A queue whose open costs span at most `reach`; one bucket holds 2^`span_log2` of them.
    pub(crate) fn new(reach: u64, span_log2: u32) -> Self {
        // Two more than the reach: the front bucket, and the one that a sum may begin in.
        let num_buckets = ((reach >> span_log2) as usize + 2)
            .next_power_of_two()
            .max(64);
        Self {
            tails: vec![(END, 0); num_buckets],
            filled: vec![0; num_buckets / 64],
            pool: Vec::new(),
            before: Vec::new(),
            free: END,
            // Few buckets are long, many are short.
            block_log2: if num_buckets > 1024 { 6 } else { 9 },
            span_log2,
            num_blocks_open: 0,
            front: 0,
        }
    }

    /// Least cost of the front bucket.
    pub(crate) const fn front_cost(&self) -> u64 {
        self.front << self.span_log2
    }

    /// Number of the bucket that a cost belongs to.
    pub(crate) const fn bucket_of(&self, cost: u64) -> u64 {
        cost >> self.span_log2
    }

    /// Bytes held.
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
                // By a quarter: the pool is as large as the most that was ever open, and a little more.
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

    /// Moves the front to the first bucket that holds something; false if none does.
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

    /// Takes a block out of the front bucket; what is pushed there meanwhile is found by the next call.
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

    /// Takes the newest entry out of the front bucket.
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
