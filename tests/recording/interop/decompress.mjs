// What @mcap/core leaves to its user: the decompression of chunks.
import decompressLz4 from "@foxglove/wasm-lz4";
import * as zstd from "@foxglove/wasm-zstd";

await Promise.all([zstd.isLoaded ?? zstd.default.isLoaded, decompressLz4.isLoaded]);
const decompressZstd = zstd.decompress ?? zstd.default.decompress;

export const decompressHandlers = {
  lz4: (bytes, size) => new Uint8Array(decompressLz4(bytes, Number(size))),
  zstd: (bytes, size) => new Uint8Array(decompressZstd(bytes, Number(size))),
};
