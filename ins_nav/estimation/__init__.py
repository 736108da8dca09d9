"""Error-state Kalman filter: error states and their dynamics, propagation of covariance, innovation gate.

Imports `ins_nav.mechanization` and below. Start with `ins_nav.estimation.error_model`.
"""
