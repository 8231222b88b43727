# tools/tiny.sh: sourced by kill.sh and memory_limits.sh. Makes a work folder, which is removed at the end, sets up a
# network whose training step takes milliseconds, and counts failures.
export OMP_WAIT_POLICY=passive
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
tiny=small,encoder_width=8,style_width=16,plane_resolution=16,channel_base=256,channel_max=16,volume_channels0=8
tiny=$tiny,volume_channels1=8,volume_channels2=8,decoder_width=16,decoder_depth=2,decoder_skip=0,view_width=16
tiny=$tiny,voxel_size_m=0.05
failures=0
