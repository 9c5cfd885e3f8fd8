//! The checksum of bodies: CRC-64 of ECMA-182, not reflected, from 0.

const POLYNOMIAL: u64 = 0x42f0_e1eb_a9ea_3693;

/// Row k: the checksums of each byte with k zeros after it, so that eight bytes are taken in one step.
const TABLES: [[u64; 256]; 8] = {
    let mut tables = [[0; 256]; 8];
    let mut byte = 0;
    while byte < 256 {
        let mut crc = (byte as u64) << 56;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc >> 63 == 1 { (crc << 1) ^ POLYNOMIAL } else { crc << 1 };
            bit += 1;
        }
        tables[0][byte] = crc;
        byte += 1;
    }
    let mut row = 1;
    while row < 8 {
        let mut byte = 0;
        while byte < 256 {
            let before: u64 = tables[row - 1][byte];
            tables[row][byte] = tables[0][(before >> 56) as usize] ^ (before << 8);
            byte += 1;
        }
        row += 1;
    }
    tables
};

/// The checksum of some bytes.
pub(super) fn of(bytes: &[u8]) -> u64 {
    let (eights, rest) = bytes.as_chunks::<8>();
    let crc = eights.iter().fold(0_u64, |crc, eight| {
        let mixed = (crc ^ u64::from_be_bytes(*eight)).to_be_bytes();
        mixed.iter().zip(TABLES.iter().rev()).fold(0, |crc, (&byte, table)| crc ^ table[usize::from(byte)])
    });
    rest.iter().fold(crc, |crc, &byte| TABLES[0][(crc >> 56) as usize ^ usize::from(byte)] ^ (crc << 8))
}

#[cfg(test)]
mod tests {
    /// Bit by bit, as the standard has it.
    fn slowly(bytes: &[u8]) -> u64 {
        bytes.iter().fold(0, |crc, &byte| {
            (0..8).fold(crc ^ (u64::from(byte) << 56), |crc, _| {
                if crc >> 63 == 1 { (crc << 1) ^ super::POLYNOMIAL } else { crc << 1 }
            })
        })
    }

    #[test]
    fn the_checksum_is_that_of_the_standard() {
        assert_eq!(super::of(b"123456789"), 0x6c40_df5f_0b49_7347);
        assert_eq!(super::of(b""), 0);
        let bytes: Vec<u8> = (0..1000_u32).map(|k| (k * k % 251) as u8).collect();
        for length in [1, 7, 8, 9, 63, 64, 65, 1000] {
            assert_eq!(super::of(&bytes[..length]), slowly(&bytes[..length]), "{length}");
        }
    }
}
