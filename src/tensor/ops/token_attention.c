/* token_attention: rows of queries, keys and values to rows of heads; every `tokens` rows are one point. */
#include "tensor/ops/shape.h"

tensor *op_token_attention(tape *t, tensor *qkv, int tokens, int heads, int width) {
    NEED(qkv);
    RULE(t, "token_attention", qkv, tokens > 0 && heads > 0 && width > 0);
    RULE(t, "token_attention", qkv,
         is_real(t, qkv) && tensor_columns(qkv) == 3 * (int64_t)heads * width &&
             tensor_rows(qkv) % tokens == 0);
    tensor *y = with_columns(t, qkv, (int64_t)heads * width);
    NEED(y);
    attention_attr attr = {tokens, heads, width};
    return tape_call(t, OP_token_attention, 1, &qkv, 1, &y, &attr, sizeof attr, 0) ? y : NULL;
}
