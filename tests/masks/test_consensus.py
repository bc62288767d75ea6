# SPDX-License-Identifier: MIT
import cv2
import numpy as np

from pinwm_drake.masks.colours import histogram
from pinwm_drake.masks.consensus import room_coloured

GREY, RED, PURPLE = (90, 90, 90), (200, 40, 40), (110, 40, 170)


def test_a_part_with_the_colour_of_a_thing_elsewhere_in_the_room_is_the_objects():
    """A red and purple object before a grey table; a purple thing stands far off, and the hull is too large."""
    image = np.full((120, 160, 3), GREY, np.uint8)
    image[:30, 120:] = PURPLE
    image[40:80, 50:90] = RED
    image[80:100, 50:70] = PURPLE
    hull, painted = np.zeros((2, 120, 160), bool)
    hull[40:100, 50:90] = True  # with a corner of the table, lower right
    painted[40:80, 50:90] = painted[80:100, 50:70] = True
    cut = painted & (image != PURPLE).any(-1)  # GrabCut gives all purple to the room
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB)
    found = room_coloured(lab, hull, cut, histogram(lab, painted))
    assert found[82:98, 52:68].all()
    assert not found[80:100, 71:].any()
