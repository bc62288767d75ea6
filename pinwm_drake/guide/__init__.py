# SPDX-License-Identifier: MIT
"""Guide of a lab: stages from a printed board to a policy, each with what it needs and what a person does next."""
