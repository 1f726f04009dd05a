// Raw deflate (RFC 1951) into a buffer of known size. A DecompressionStream takes four times as
// long for a tile of 2 KiB, and thousands of tiles come at once.

const kMaxBits = 15;
const kLengthBase = [
  3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131,
  163, 195, 227, 258,
];
const kLengthExtra = [
  0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0,
];
const kDistanceBase = [
  1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025, 1537, 2049,
  3073, 4097, 6145, 8193, 12289, 16385, 24577,
];
const kDistanceExtra = [
  0, 0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 8, 9, 9, 10, 10, 11, 11, 12, 12, 13, 13,
];
const kCodeLengthOrder = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];

// A canonical Huffman code: how many symbols there are of each length, and they in order.
interface Code {
  counts: Uint16Array;
  symbols: Uint16Array;
}

function makeCode(lengths: number[]): Code {
  const counts = new Uint16Array(kMaxBits + 1);
  for (const length of lengths) counts[length]!++;
  counts[0] = 0;
  const offsets = new Uint16Array(kMaxBits + 2);
  for (let k = 1; k <= kMaxBits; ++k) offsets[k + 1] = offsets[k]! + counts[k]!;
  const symbols = new Uint16Array(lengths.length);
  lengths.forEach((length, symbol) => {
    if (length !== 0) symbols[offsets[length]!++] = symbol;
  });
  return { counts, symbols };
}

const kFixedLiterals = makeCode(
  Array.from({ length: 288 }, (_, k) => (k < 144 ? 8 : k < 256 ? 9 : k < 280 ? 7 : 8)),
);
const kFixedDistances = makeCode(new Array<number>(30).fill(5));

class BitReader {
  private at = 0;
  private held = 0;
  private heldBits = 0;
  constructor(private readonly bytes: Uint8Array) {}

  bits(count: number): number {
    while (this.heldBits < count) {
      this.held |= this.byte() << this.heldBits;
      this.heldBits += 8;
    }
    const value = this.held & ((1 << count) - 1);
    this.held >>>= count;
    this.heldBits -= count;
    return value;
  }

  symbol(code: Code): number {
    let value = 0;
    let first = 0;
    let index = 0;
    for (let length = 1; length <= kMaxBits; ++length) {
      value |= this.bits(1);
      const count = code.counts[length]!;
      if (value - count < first) return code.symbols[index + value - first]!;
      index += count;
      first = (first + count) << 1;
      value <<= 1;
    }
    throw new Error("a tile has a code that does not exist");
  }

  // The rest of the byte is skipped.
  alignedByte(): number {
    this.held = 0;
    this.heldBits = 0;
    return this.byte();
  }

  private byte(): number {
    const byte = this.bytes[this.at++];
    if (byte === undefined) throw new Error("a tile is cut short");
    return byte;
  }
}

class Output {
  private at = 0;
  constructor(readonly bytes: Uint8Array) {}

  push(byte: number): void {
    if (this.at >= this.bytes.length) throw new Error("a tile is too large");
    this.bytes[this.at++] = byte;
  }

  repeat(distance: number, length: number): void {
    if (distance > this.at) throw new Error("a tile refers to what is not in it");
    for (let k = 0; k < length; ++k) this.push(this.bytes[this.at - distance]!);
  }

  isFull(): boolean {
    return this.at === this.bytes.length;
  }
}

// Throws an Error where `packed` is not the raw deflate of `size` bytes.
export function inflate(packed: Uint8Array, size: number): Uint8Array<ArrayBuffer> {
  const input = new BitReader(packed);
  const bytes = new Uint8Array(size);
  const output = new Output(bytes);
  for (let isLast = false; !isLast;) {
    isLast = input.bits(1) === 1;
    inflateBlock(input, output, input.bits(2));
  }
  if (!output.isFull()) throw new Error("a tile is too small");
  return bytes;
}

function inflateBlock(input: BitReader, output: Output, kind: number): void {
  if (kind === 0) return copyStored(input, output);
  if (kind === 1) return inflateCodes(input, output, kFixedLiterals, kFixedDistances);
  if (kind === 2) return inflateCodes(input, output, ...readCodes(input));
  throw new Error("a tile has a block of unknown kind");
}

function copyStored(input: BitReader, output: Output): void {
  const length = input.alignedByte() | (input.alignedByte() << 8);
  input.alignedByte(); // the length once more, inverted
  input.alignedByte();
  for (let k = 0; k < length; ++k) output.push(input.alignedByte());
}

function readCodes(input: BitReader): [Code, Code] {
  const literals = input.bits(5) + 257;
  const distances = input.bits(5) + 1;
  const lengthCodes = input.bits(4) + 4;
  const lengths = new Array<number>(19).fill(0);
  for (let k = 0; k < lengthCodes; ++k) lengths[kCodeLengthOrder[k]!] = input.bits(3);
  const all = readLengths(input, makeCode(lengths), literals + distances);
  return [makeCode(all.slice(0, literals)), makeCode(all.slice(literals, literals + distances))];
}

function readLengths(input: BitReader, code: Code, count: number): number[] {
  const lengths: number[] = [];
  while (lengths.length < count) {
    const symbol = input.symbol(code);
    if (symbol < 16) lengths.push(symbol);
    else if (symbol === 16) pushTimes(lengths, lengths[lengths.length - 1] ?? 0, 3 + input.bits(2));
    else if (symbol === 17) pushTimes(lengths, 0, 3 + input.bits(3));
    else pushTimes(lengths, 0, 11 + input.bits(7));
  }
  return lengths;
}

function pushTimes(list: number[], value: number, times: number): void {
  for (let k = 0; k < times; ++k) list.push(value);
}

function inflateCodes(input: BitReader, output: Output, literals: Code, distances: Code): void {
  for (;;) {
    const symbol = input.symbol(literals);
    if (symbol < 256) {
      output.push(symbol);
      continue;
    }
    if (symbol === 256) return;
    const length = withExtra(input, kLengthBase, kLengthExtra, symbol - 257);
    const distance = withExtra(input, kDistanceBase, kDistanceExtra, input.symbol(distances));
    output.repeat(distance, length);
  }
}

function withExtra(input: BitReader, base: number[], extra: number[], symbol: number): number {
  const first = base[symbol];
  if (first === undefined) throw new Error("a tile has a symbol that does not exist");
  return first + input.bits(extra[symbol]!);
}
