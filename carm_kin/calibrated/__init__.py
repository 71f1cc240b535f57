"""The calibrated C-arm in use: where its rotation centre is, what its X-rays show, whether it still holds."""
