"""Numbers of 16 bits with the exponents of 32 (bfloat16), in which some CPUs convolve twice as fast."""

import torch


def has_bfloat16(device: str = "cpu") -> bool:
    """Flag: a device is a CPU with instructions for bfloat16; without them it is slower than 32 bits are."""
    supported: bool = torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()
    return device == "cpu" and supported
