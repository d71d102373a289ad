//! Places along a space-filling curve: what is near in space is mostly near along it.

/// Position of a cell along Morton's curve: the bits of its N coordinates in turn, of each the lowest 32 / N.
pub fn code<const N: usize>(cell: [u32; N]) -> u32 {
    let bits = u32::BITS / N as u32;
    let mut code = 0;
    for bit in 0..bits {
        for (axis, coordinate) in cell.iter().enumerate() {
            code |= (coordinate >> bit & 1) << (N as u32 * bit + axis as u32);
        }
    }
    code
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_taken_in_turn() {
        assert_eq!(code([0b11, 0b01]), 0b0111);
        assert_eq!(code([0, 0, 0b100]), 0b1_0000_0000);
        assert_eq!(code([0xffff, 0xffff]), u32::MAX);
    }
}
